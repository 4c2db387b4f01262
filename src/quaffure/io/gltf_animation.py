"""Animations of a glTF file."""

import numpy as np

from quaffure.body.character import AnimationChannel, CharacterAnimation, SkinnedMesh
from quaffure.io.character_limits import LAST_SECOND
from quaffure.io.distinct_names import DistinctNames
from quaffure.io.gltf_accessor import GltfArrays
from quaffure.io.gltf_entry import Entry
from quaffure.io.gltf_nodes import GltfScene

KINDS = {"translation": "VEC3", "rotation": "VEC4", "scale": "VEC3", "weights": "SCALAR"}
INTERPOLATIONS = ("LINEAR", "STEP", "CUBICSPLINE")
SHORTEST_QUATERNION = 1e-3


def read_animations(
    root: Entry, arrays: GltfArrays, scene: GltfScene, meshes: tuple[SkinnedMesh, ...]
) -> tuple[CharacterAnimation, ...]:
    """The animations of a document that move nodes or weights of morph targets.

    Raises:
        InputError: times that decrease, another number of values than keys, a rotation without length.
    """
    targets = {mesh.node: len(mesh.morph_targets) for mesh in meshes}
    animations: list[CharacterAnimation] = []
    names = DistinctNames()
    for index, entry in enumerate(root.entries("animations")):
        samplers = entry.entries("samplers")
        read = [_channel(channel, samplers, arrays, scene, targets) for channel in entry.entries("channels")]
        channels = tuple(channel for channel in read if channel is not None)
        if not channels:
            continue
        name = names.add(entry.text("name").strip() or f"animation{index}")
        animations.append(CharacterAnimation(name, channels))
    return tuple(animations)


def _channel(
    entry: Entry, samplers: list[Entry], arrays: GltfArrays, scene: GltfScene, targets: dict[int, int]
) -> AnimationChannel | None:
    """A channel; None of one that moves something else, such as what an extension defines."""
    target = entry.required("target")
    path = target.text("path")
    if "node" not in target or path not in KINDS:
        return None
    node = int(scene.order[target.index("node", len(scene.entries))])
    width = {"rotation": 4, "weights": targets.get(node, 0)}.get(path, 3)
    if not width:
        return None
    sampler = samplers[entry.index("sampler", len(samplers))]
    interpolation = sampler.text("interpolation", "LINEAR")
    if interpolation not in INTERPOLATIONS:
        sampler.fail(f"an interpolation of {', '.join(INTERPOLATIONS)}", f"{interpolation[:20]!r}")
    accessors = len(arrays.accessors)
    times = arrays.floats(sampler.index("input", accessors), "SCALAR", LAST_SECOND)[:, 0].astype(np.float64)
    if (np.diff(times) < 0).any():
        sampler.fail("times that do not decrease", "others")
    values = arrays.floats(sampler.index("output", accessors), KINDS[path])
    rows = 3 if interpolation == "CUBICSPLINE" else 1
    if values.size != len(times) * rows * width:
        sampler.fail(f"{len(times) * rows * width} values of {path}", f"{values.size}")
    values = values.reshape(len(times), rows, width).astype(np.float64)
    if path == "rotation" and np.linalg.norm(values[:, rows // 2], axis=-1).min() < SHORTEST_QUATERNION:
        sampler.fail("rotations of length 1", "one of length 0")
    return AnimationChannel(node, path, interpolation, times, values)
