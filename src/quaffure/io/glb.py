"""glTF 2.0 in one binary file (.glb), for pages and engines: body and strands as meshes.

Metres, y up and the face towards +z, as glTF asks: (x, y, z) of the drape is (x, z, -y). Every frame of the hair is a
morph target; between two frames a viewer mixes their targets, so hair moves along straight lines. The body is morphed,
too, or skinned to its skeleton (`quaffure.io.glb_skeleton`). Only positions are morphed; normals are those of the first
frame. Strands have the points and widths of their source, and its colours as those of vertices, linear RGB.
"""

import json
import shutil
import struct
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int

from quaffure.errors import InputError
from quaffure.geometry.mesh import angle_weighted_vertex_normals
from quaffure.hair.export_clip import BODY_COLOUR, HAIR_COLOUR, ExportClip
from quaffure.io.atomic import replacing
from quaffure.io.glb_asset import GlbAsset
from quaffure.io.glb_skeleton import SkinnedBody
from quaffure.io.output_path import check_suffix
from quaffure.io.strand_mesh import SIDES, strand_mesh_faces, strand_mesh_normals, strand_mesh_positions

GLB_SUFFIX = ".glb"
MOST_BYTES = 2**32 - 1
"""The format counts with 32 bits."""
JSON_CHUNK, BINARY_CHUNK = 0x4E4F534A, 0x004E4942
BODY, HAIR = 0, 1
"""Meshes, and materials."""


def write_glb(path: Path, clip: ExportClip, on_frame: Callable[[], object] = lambda: None) -> None:
    """Write body and strands of a drape as meshes, ribbons or tubes as the settings of the clip say.

    Args:
        on_frame: called after each frame.

    Raises:
        InputError: another suffix than .glb, more than 4 GB, a skeleton of a clip without a binding, or not writable.
    """
    check_suffix(path, GLB_SUFFIX)
    if clip.settings.skinned and clip.binding is None:
        raise InputError("--skinned", "a drape of the body of this package", "another body")
    with replacing(path) as temporary, tempfile.TemporaryFile(dir=temporary.parent) as binary:
        asset = GlbAsset(binary, path, MOST_BYTES)
        # The colours of vertices are multiplied by that of the material.
        hair_colour = (1.0, 1.0, 1.0) if clip.has_colours else HAIR_COLOUR
        for name, colour, roughness in (("Body", BODY_COLOUR, 0.6), ("Hair", hair_colour, 0.45)):
            asset.add_material(name, colour, roughness)
        (_add_skinned if clip.settings.skinned else _add_morphed)(asset, clip, on_frame)
        document = json.dumps(asset.document(str(clip.sequence.meta.get("motion", "drape")))).encode()
        document += b" " * (-len(document) % 4)
        length = 12 + 8 + len(document) + 8 + asset.size
        if length > MOST_BYTES:
            raise InputError(path, "at most 4 GB of .glb (--points, --every)", f"{length / 1e9:.1f} GB")
        with temporary.open("wb") as file:
            file.write(struct.pack("<4sII", b"glTF", 2, length))
            file.write(struct.pack("<II", len(document), JSON_CHUNK) + document)
            file.write(struct.pack("<II", asset.size, BINARY_CHUNK))
            binary.seek(0)
            shutil.copyfileobj(binary, file)


def _add_morphed(asset: GlbAsset, clip: ExportClip, on_frame: Callable[[], object]) -> None:
    body = np.array(clip.body_vertices(0))
    asset.add_mesh("Body", body, _normals(body, clip.body_faces), clip.body_faces)
    hair = _add_hair(asset, clip, clip.points(0))
    on_frame()
    for frame in clip.frames[1:]:
        asset.add_target(BODY, clip.body_vertices(frame) - body)
        asset.add_target(HAIR, _hair_positions(clip, clip.points(frame)) - hair)
        on_frame()
    for mesh in (BODY, HAIR):
        asset.add_root(asset.add_node(asset.meshes[mesh]["name"], mesh=mesh))
        _play(asset, clip, node=mesh)


def _add_skinned(asset: GlbAsset, clip: ExportClip, on_frame: Callable[[], object]) -> None:
    """The hair is a child of the head, in whose frame it moves little."""
    assert clip.binding is not None
    skinned, body = SkinnedBody(clip), clip.binding.body_vertices
    asset.add_mesh("Body", body, _normals(body, clip.sequence.body_faces), clip.sequence.body_faces)
    hair = _add_hair(asset, clip, skinned.in_head(0, clip.points(0)))
    on_frame()
    for frame in clip.frames[1:]:
        asset.add_target(HAIR, _hair_positions(clip, skinned.in_head(frame, clip.points(frame))) - hair)
        on_frame()
    head = skinned.add_to(asset, BODY)
    node = asset.add_node("Hair", mesh=HAIR)
    asset.nodes[head].setdefault("children", []).append(node)
    _play(asset, clip, node)


def _add_hair(asset: GlbAsset, clip: ExportClip, points: np.ndarray) -> np.ndarray:
    """Returns:
    Vertices of the mesh.
    """
    positions, profile = _hair_positions(clip, points), clip.settings.mesh
    faces = strand_mesh_faces(clip.counts, profile)
    asset.add_mesh("Hair", positions, strand_mesh_normals(points, clip.counts, profile), faces)
    if clip.has_colours:
        asset.add_attribute(HAIR, "COLOR_0", np.repeat(clip.colours, SIDES[profile], axis=0))
    return positions


def _hair_positions(clip: ExportClip, points: np.ndarray) -> np.ndarray:
    return strand_mesh_positions(points, clip.counts, clip.widths, clip.settings.mesh)


def _play(asset: GlbAsset, clip: ExportClip, node: int) -> None:
    """The weight of a frame's target is 1 at its time, and that of all others 0; the first frame has none."""
    count = len(clip.frames)
    if count > 1:
        asset.add_channel(node, "weights", clip.times, np.eye(count, dtype=np.float32)[:, 1:].reshape(-1, 1))


def _normals(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "k 3"]) -> Float[np.ndarray, "v 3"]:
    normals = angle_weighted_vertex_normals(torch.from_numpy(vertices)[None], torch.from_numpy(faces).long())[0]
    return torch.nn.functional.normalize(normals, dim=-1).numpy()
