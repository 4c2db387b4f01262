"""Alembic: strands and guides as Unreal imports them, a groom asset or a groom cache.

Attributes, their types and scopes are those of schema 1.5 of Epic's "Alembic for Grooms Specification". Unreal's
importer reads coordinates as they are, in centimetres and in its own axes: left-handed, z up. So (x, y, z) in metres is
written as (100 x, -100 y, 100 z): a body that faces -y here faces +y there, as in an FBX file of it. Our reader
recognizes these files by `groom_tool`, and negates y again; other axes need another mark. An asset and the cache of its
animation have the same curves in the same order.
"""

import json
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float32, Int32

from quaffure.errors import InputError
from quaffure.hair.export_clip import HAIR_COLOUR, MOST_POINTS, ExportClip
from quaffure.io.alembic_process import TOOL_PROPERTY, WRITER
from quaffure.io.atomic import replacing, replacing_together
from quaffure.io.library_process import library_environment
from quaffure.io.output_path import check_suffix

if TYPE_CHECKING:
    from quaffure.io.alembic_archive import CurvesDescription, Description

ALEMBIC_SUFFIX = ".abc"
VERSION = {"groom_version_major": 1, "groom_version_minor": 5}
TOOL = f"{WRITER} {version(WRITER)}"
CENTIMETRES = 100.0
UNREAL_FROM_WORLD = np.array([CENTIMETRES, -CENTIMETRES, CENTIMETRES], dtype=np.float32)
CONVENTIONS = "centimetres, left-handed axes, z up, as in Unreal: (x, y, z) m of the drape is (100 x, -100 y, 100 z)"
CACHE, ASSET = "groom cache", "groom asset"
TOP, STRANDS, GUIDES = "groom", "strands", "guides"


class _Attribute(NamedTuple):
    name: str
    kind: str
    scope: str
    values: np.ndarray


def write_groom_files(path: Path, asset: Path, clip: ExportClip, on_frame: Callable[[], object] = lambda: None) -> None:
    """Write a groom cache with its groom asset: both or none.

    Args:
        path: of the cache.
        asset: of the asset.
        on_frame: as of `write_groom_cache`.

    Raises:
        InputError: as `write_groom_cache`.
    """
    _check(path, clip)
    with replacing_together(path, asset) as (cache_file, asset_file):
        _write(asset_file, clip, _at_rest(clip), ASSET)
        _write(cache_file, clip, _animated(clip, on_frame), CACHE)


def write_groom_cache(path: Path, clip: ExportClip, on_frame: Callable[[], object] = lambda: None) -> None:
    """Write the frames of a drape, for Unreal a groom cache; `write_groom_asset` writes its asset.

    Memory does not grow with the number of frames.

    Args:
        on_frame: called after each frame.

    Raises:
        InputError: another suffix than .abc, strands of more than 255 vertices, or not writable.
    """
    _check(path, clip)
    with replacing(path) as temporary:
        _write(temporary, clip, _animated(clip, on_frame), CACHE)


def write_groom_asset(path: Path, clip: ExportClip) -> None:
    """Write the hair at rest, for Unreal a groom asset.

    Raises:
        InputError: as `write_groom_cache`.
    """
    _check(path, clip)
    with replacing(path) as temporary:
        _write(temporary, clip, _at_rest(clip), ASSET)


def _animated(clip: ExportClip, on_frame: Callable[[], object]) -> Iterator[tuple[np.ndarray, ...]]:
    for frame in clip.frames:
        yield clip.guides(frame), clip.points(frame)
        on_frame()


def _at_rest(clip: ExportClip) -> list[tuple[np.ndarray, ...]]:
    return [(clip.rest_guides, clip.rest_points)]


def _check(path: Path, clip: ExportClip) -> None:
    check_suffix(path, ALEMBIC_SUFFIX)
    most = max(int(clip.counts.max()), clip.point_count)
    if most > MOST_POINTS:
        raise InputError(path, f"at most {MOST_POINTS} vertices a strand (--points)", f"{most}")


def _write(path: Path, clip: ExportClip, frames: Iterable[tuple[np.ndarray, ...]], what: str) -> None:
    attributes = {GUIDES: _guide_attributes(clip), STRANDS: _strand_attributes(clip)}
    command = [sys.executable, "-P", "-m", "quaffure.io.alembic_archive", str(path.absolute())]
    streams: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, **streams, env=library_environment()) as process:
        assert process.stdin is not None
        try:
            _send(process.stdin, np.array(json.dumps(_description(clip, attributes, what))))
            for name, own in attributes.items():
                _send(process.stdin, _counts(clip, name))
                for attribute in own:
                    _send(process.stdin, attribute.values)
            for curves in (one for frame in frames for one in frame):
                _send(process.stdin, _in_unreal(curves))
        except BrokenPipeError:  # it has ended, which its exit code explains
            pass
        except BaseException:
            process.kill()
            raise
        _, said = process.communicate()
    if process.returncode:
        last = said.decode(errors="replace").strip().splitlines()[-1:] or [f"exit code {process.returncode}"]
        raise OSError(f"the disk may be full: the Alembic library ended ({last[0]})")


class _Writer(NamedTuple):
    """Numpy asks a file for its position, which a pipe does not have."""

    write: Callable[[bytes], object]


def _send(stream: IO[bytes], array: np.ndarray) -> None:
    np.lib.format.write_array(_Writer(stream.write), np.asarray(array, order="C"), allow_pickle=False)


def _description(clip: ExportClip, attributes: dict[str, list[_Attribute]], what: str) -> "Description":
    meta = {key: clip.sequence.meta.get(key, "") for key in ("groom", "licence", "motion", "draper")}
    curves: list[CurvesDescription] = [
        {
            "name": name,
            "attributes": [{"name": one.name, "kind": one.kind, "scope": one.scope} for one in own],
        }
        for name, own in attributes.items()
    ]
    return {
        "rate": clip.sequence.fps / clip.settings.every,
        "start": clip.start,
        "tool": TOOL,
        "about": f"{what}: {CONVENTIONS}",
        "top": TOP,
        "integers": VERSION,
        "texts": {
            TOOL_PROPERTY: TOOL,
            "groom_properties": json.dumps({"file": what, "conventions": CONVENTIONS, **meta}, ensure_ascii=False),
        },
        "curves": curves,
    }


def _counts(clip: ExportClip, name: str) -> Int32[np.ndarray, " c"]:
    """Points of every curve."""
    return clip.counts if name == STRANDS else np.full(len(clip.guide_index), clip.point_count, np.int32)


def _guide_attributes(clip: ExportClip) -> list[_Attribute]:
    count = len(clip.guide_index)
    return [
        *_identity(clip.guide_identifiers, True, clip.guide_groups, clip.group_names),
        _Attribute("groom_width", "float", "vertex", np.tile(CENTIMETRES * clip.strand_width, count)),
        _Attribute(
            "groom_color", "float3", "vertex", np.tile(np.array(HAIR_COLOUR, np.float32), (count * clip.point_count, 1))
        ),
        *_root_uv(clip.guide_root_uv),
    ]


def _strand_attributes(clip: ExportClip) -> list[_Attribute]:
    """Strands without ids of their own continue those of the guides, so that every curve has one."""
    guides, weights = clip.closest_guides
    own = len(clip.guide_index) + np.arange(clip.strand_count) if clip.identifiers is None else clip.identifiers
    return [
        *_identity(own, False, clip.groups, clip.group_names),
        _Attribute("groom_width", "float", "vertex", CENTIMETRES * clip.widths),
        _Attribute("groom_color", "float3", "vertex", clip.colours),
        *_root_uv(clip.root_uv),
        _Attribute("groom_closest_guides", "int3", "uniform", clip.guide_identifiers[guides]),
        _Attribute("groom_guide_weights", "float3", "uniform", weights),
    ]


def _identity(identifiers: np.ndarray, are_guides: bool, groups: np.ndarray, names: Sequence[str]) -> list[_Attribute]:
    return [
        _Attribute("groom_id", "int", "uniform", identifiers),
        _Attribute("groom_guide", "int", "uniform", np.full(len(groups), int(are_guides))),
        _Attribute("groom_group_id", "int", "uniform", groups),
        _Attribute("groom_group_name", "text", "uniform", np.array(names)[groups]),
    ]


def _root_uv(values: np.ndarray | None) -> list[_Attribute]:
    return [] if values is None else [_Attribute("groom_root_uv", "float2", "uniform", values)]


def _in_unreal(strands: np.ndarray) -> Float32[np.ndarray, "p 3"]:
    return np.ascontiguousarray(strands.reshape(-1, 3) * UNREAL_FROM_WORLD, dtype=np.float32)
