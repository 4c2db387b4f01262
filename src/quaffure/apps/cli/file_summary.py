"""What a file of any kind holds, what is guessed about it, and what would be refused."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from quaffure.apps.cli.character_summary import character_summary
from quaffure.apps.cli.motion_summary import (
    REFUSED,
    Summary,
    extent,
    joint_map_summary,
    motion_summary,
    usable_motion,
)
from quaffure.body.body_model import BodyModel, load_body
from quaffure.body.character_clip import character_clip
from quaffure.body.clips import CLIP_NAMES
from quaffure.body.joint_map import joint_map_text
from quaffure.body.joint_names import guess_joint_map
from quaffure.errors import InputError
from quaffure.hair.file_frame import UNKNOWN, FileFrame
from quaffure.hair.groom import Groom
from quaffure.hair.registration import register_groom
from quaffure.hair.resample import polyline_lengths
from quaffure.hair.scalp_texture import select_guides
from quaffure.hair.strands import held_parts_of
from quaffure.io.amass import ROTATION_KEYS
from quaffure.io.bvh import read_bvh
from quaffure.io.drape_file import read_drape
from quaffure.io.groom_file import is_groom_file, read_groom
from quaffure.io.load_groom import load_groom, read_head
from quaffure.io.load_motion import load_motion
from quaffure.io.ply_tables import read_ply_tables
from quaffure.io.read_character import CHARACTER_SUFFIXES, read_character
from quaffure.io.read_motion import SKELETON_SUFFIXES, read_joint_map
from quaffure.io.read_strands import STRAND_READERS, read_strands
from quaffure.model.checkpoint import load_network
from quaffure.npz import array_names
from quaffure.procedural.hair_style import STYLES

BODY_ARRAYS = {"rest_vertices", "skin_weights", "scalp_faces"}
DRAPE_ARRAYS = {"strands", "posed", "body_vertices"}
MOTION_ARRAYS = ({"body_pose", "fps"}, *({*keys} for keys in ROTATION_KEYS))
MOST_NAMES = 12
"""Longest list of groups in a summary."""
SUFFIXES = (*SKELETON_SUFFIXES, ".obj", ".safetensors", *sorted(STRAND_READERS))


def summary_of(path: Path, body: BodyModel, joints: Path | None = None, frame: FileFrame = UNKNOWN) -> Summary:
    """What a file holds, or a bundled groom or motion: its `kind` (`strands`, `groom`, `motion`, `character`, `body`,
    `drape`, `head` or `weights`), and by name what there is to know of it; `REFUSED` where it cannot be used.

    Args:
        path: the file, or the bundled name.
        joints: a joint map for a motion file or a character.
        frame: what is known of a groom file's axes and unit.

    Raises:
        InputError: no such file, of no kind that is read, or one that cannot be read.
    """
    if str(path) in STYLES:
        return _groom(load_groom(str(path), body))
    if str(path) in CLIP_NAMES:
        return {"kind": "motion", **motion_summary(load_motion(path, body), body)}
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(path, f"a file that is read ({', '.join(SUFFIXES)})", f"suffix {path.suffix!r}")
    if suffix == ".bvh":
        return _bvh(path, body, joints)
    if suffix in CHARACTER_SUFFIXES:
        return character_summary(path, body, joints)
    if suffix == ".obj" or (suffix == ".ply" and _is_mesh(path)):
        return _head(path)
    if suffix == ".safetensors":
        return _weights(path)
    if suffix == ".npz":
        names = array_names(path)
        if names >= DRAPE_ARRAYS:
            return _drape(path)
        if names >= BODY_ARRAYS:
            return _body(path)
        if is_groom_file(path):
            return _groom(read_groom(path, body))
        if any(names >= keys for keys in MOTION_ARRAYS):
            return {"kind": "motion", **usable_motion(path, body)}
    return _strands(path, body, frame)


def joint_map_of(path: Path) -> str:
    """The joint map of a motion file or a character by its names, as the text of a TOML file, complete or not.

    Raises:
        InputError: another file.
    """
    suffix = path.suffix.lower()
    if suffix not in SKELETON_SUFFIXES:
        expected = f"a file whose joints have names ({', '.join(SKELETON_SUFFIXES)})"
        raise InputError(path, expected, f"suffix {path.suffix!r}")
    clip = read_bvh(path) if suffix == ".bvh" else character_clip(read_character(path), None, 1.0)
    return joint_map_text(guess_joint_map(clip)[0])


def _strands(path: Path, body: BodyModel, frame: FileFrame) -> Summary:
    strands = read_strands(path)
    lengths = polyline_lengths(strands)
    summary: Summary = {
        "kind": "strands",
        "strands": len(strands),
        "bald_roots": strands.dropped,
        "points": len(strands.points),
        "points_a_strand": [int(strands.counts.min()), int(strands.counts.max())],
        "length_units": _statistics(lengths),
        "extent_units": extent(strands.points),
        "held_parts": sorted(held_parts_of(strands)),
        "attributes": sorted({*strands.attributes.arrays()} - {"group_names"}),
        "groups": _shortened(strands.attributes.group_names),
    }
    if strands.times is not None and len(strands.times) > 1:
        seconds = float(strands.times[-1] - strands.times[0])
        rate = round((len(strands.times) - 1) / max(seconds, 1e-9), 3)
        summary |= {"samples": len(strands.times), "samples_a_second": rate}
    try:
        groom, report = register_groom(strands, body, path.stem, frame=frame)
    except InputError as error:
        return summary | {REFUSED: f"expected {error.expected}, found {error.found}"}
    return summary | {
        "unit": report.unit,
        "millimetres_a_unit": round(1e3 * report.scale, 3),
        "up": report.up_axis,
        "forward": report.forward_axis,
        "length_m": _statistics(groom.strand_lengths.numpy()),
        "strands_on_the_scalp": report.kept,
        "guides": len(select_guides(groom)),
        "beard": report.beard,
        "eyebrows": report.eyebrows,
        "too_short": report.unused.without_length,
        "too_far": report.unused.too_far,
        "stored_from_the_tip": report.turned,
        "single_strands_turned_round": report.turned_strands,
        "root_distance_mm": {"median": round(report.median_residual, 2), "largest": round(report.max_residual, 2)},
        "inside_on_arrival_percent": round(100 * report.inside_before, 2),
    }


def _shortened(names: Sequence[str]) -> list[str]:
    more = len(names) - MOST_NAMES
    return [*names[:MOST_NAMES], *([f"{more} more"] if more > 0 else [])]


def _groom(groom: Groom) -> Summary:
    return {
        "kind": "groom",
        "name": groom.name,
        "licence": groom.licence,
        "strands": len(groom),
        "points_a_strand": groom.rest_strands.shape[1],
        "guides": len(select_guides(groom)),
        "length_m": _statistics(groom.strand_lengths.numpy()),
        "held_edges_percent": round(100 * float(groom.held_edges.float().mean()), 1),
        "held_parts": sorted(held_parts_of(groom)),
    }


def _bvh(path: Path, body: BodyModel, joints: Path | None) -> Summary:
    clip = read_bvh(path)
    joint_map = guess_joint_map(clip)[0] if joints is None else read_joint_map(joints)
    file = {
        "kind": "motion",
        "joints": len(clip.joint_names),
        "frames_of_the_file": len(clip.values),
        "fps_of_the_file": round(clip.fps, 3),
        **joint_map_summary(clip, joint_map),
    }
    return file | usable_motion(path, body, joints)


def _drape(path: Path) -> Summary:
    drape = read_drape(path)
    return {
        "kind": "drape",
        "frames": len(drape),
        "fps": round(float(drape.fps), 3),
        "strands": drape.strands.shape[1],
        "points_a_strand": drape.strands.shape[2],
        "length_m": _statistics(drape.rest_lengths.sum(1)),
        "extent_m": extent(drape.strands.reshape(-1, 3)),
        "travels_m": None if drape.body_translation is None else extent(drape.body_translation),
        "body_shape": [round(float(value), 3) for value in drape.body_shape],
        "held_parts": sorted(held_parts_of(drape)),
        "meta": drape.meta,
    }


def _body(path: Path) -> Summary:
    body = load_body(path)
    return {
        "kind": "body",
        "character": None if body.origin is None else body.origin.source,
        "joints": len(body.joint_names),
        "vertices": len(body.rest_vertices),
        "triangles": len(body.faces),
        "scalp_triangles": len(body.scalp.faces),
        "extent_m": extent(body.rest_vertices.numpy()),
    }


def _weights(path: Path) -> Summary:
    network, material, notes = load_network(path)
    numbers = sum(parameter.numel() for parameter in network.parameters())
    return {"kind": "weights", "parameters": numbers, "material": vars(material), "notes": notes}


def _head(path: Path) -> Summary:
    mesh = read_head(path)
    return {
        "kind": "head",
        "vertices": len(mesh.vertices),
        "triangles": len(mesh.faces),
        "extent_units": extent(mesh.vertices),
    }


def _is_mesh(path: Path) -> bool:
    return "face" in read_ply_tables(path)


def _statistics(values: np.ndarray) -> dict[str, float]:
    numbers = {"smallest": values.min(), "mean": values.mean(), "largest": values.max()}
    return {name: float(f"{value:.4g}") for name, value in numbers.items()}
