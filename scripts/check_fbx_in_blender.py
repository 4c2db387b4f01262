"""Compare our reader of FBX with Blender's: `check_fbx_in_blender.py CHARACTER.glb FOLDER --python PYTHON`.

PYTHON is one with bpy and numpy, which is run with this script; without bpy nothing is compared. In Blender the
character, with an animation, is exported as FBX in several ways, and each file is imported again. Our reader gets
the same files: vertices of all meshes and joints in some frames, and weights, are compared. Prints the largest
differences, and fails beyond 0.1 mm or 1e-5 of a weight. The files stay in FOLDER.
"""

import argparse
import json
import struct
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

try:
    import bpy
except ImportError:
    bpy = None

MOST_DISTANCE, MOST_WEIGHT = 1e-4, 1e-5  # m, share
FPS, FRAMES = 30, (1, 6, 16, 31)
"""Frames from 1 that have keys in every file: between sparse ones Blender joins quaternions, FBX angles."""
TURNED = {"Hips": 0.3, "Spine1": 0.4, "Neck": 0.3, "Head": 0.7, "LeftArm": 0.9, "RightForeArm": 1.1, "LeftUpLeg": 0.8}
"""Largest angles of joints in the animation [rad]."""
Y_UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
"""From Blender's axes to those of glTF."""
EXPORTS: dict[str, dict[str, Any]] = {
    "default": {},
    "z_up": {"axis_forward": "Y", "axis_up": "Z"},
    "metres": {"apply_scale_options": "FBX_SCALE_UNITS"},
    "space_applied": {"bake_space_transform": True, "apply_scale_options": "FBX_SCALE_ALL"},
    "sparse": {"bake_anim_simplify_factor": 0.0, "bake_anim_step": 5.0},
    "other_bone_axes": {"primary_bone_axis": "X", "secondary_bone_axis": "Y", "add_leaf_bones": True},
}


def animated(path: Path) -> bytes:
    """A .glb without its compression by meshopt, which Blender does not read, and with an animation of a second."""
    from quaffure.io.gltf_accessor import MESHOPT, GltfArrays
    from quaffure.io.gltf_document import open_gltf

    document = open_gltf(path)
    arrays, fields, binary = GltfArrays(document), dict(document.root.fields), bytearray()

    def add(content: bytes) -> dict[str, int]:
        binary.extend(bytes(-len(binary) % 4))
        binary.extend(content)
        return {"buffer": 0, "byteOffset": len(binary) - len(content), "byteLength": len(content)}

    def accessor(values: np.ndarray, kind: str) -> int:
        fields["bufferViews"].append(add(np.float32(values).tobytes()))
        view = {"bufferView": len(fields["bufferViews"]) - 1, "componentType": 5126, "type": kind}
        fields["accessors"].append({**view, "count": len(values), "min": [0.0], "max": [1.0]})
        return len(fields["accessors"]) - 1

    for index, view in enumerate(fields["bufferViews"]):
        view |= add(arrays._view(index).tobytes())
        view.pop("extensions", None)
    channels = [(node, path, accessor(*values)) for node, path, *values in moves(fields)]
    times = accessor(np.arange(FRAMES[-1]) / FPS, "SCALAR")
    fields["animations"] = [{
        "name": "moves", "samplers": [{"input": times, "output": values} for _, _, values in channels],
        "channels": [{"sampler": index, "target": {"node": node, "path": path}}
                     for index, (node, path, _) in enumerate(channels)],
    }]  # fmt: skip
    binary += bytes(-len(binary) % 4)
    fields["buffers"] = [{"byteLength": len(binary)}]
    for key in ("extensionsUsed", "extensionsRequired"):
        fields[key] = [name for name in fields.get(key, []) if name != MESHOPT]
    text = json.dumps(fields).encode()
    text += b" " * (-len(text) % 4)
    parts = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(binary), 0x004E4942) + binary
    return struct.pack("<III", 0x46546C67, 2, 12 + len(parts)) + parts


def moves(fields: dict[str, Any]) -> Iterator[tuple[int, str, np.ndarray, str]]:
    """Rotations of joints, the way of the hips, and weights of a shape of the first mesh that has some, by frame."""
    from scipy.spatial.transform import Rotation

    frame = np.arange(FRAMES[-1])
    share = np.sin(0.2 * frame)
    nodes = {node.get("name"): index for index, node in enumerate(fields["nodes"])}
    for name, angle in TURNED.items():
        angles = angle * np.stack([share, 0.5 * np.cos(0.3 * frame), 0.3 * share], axis=1)
        rest = Rotation.from_quat(fields["nodes"][nodes[name]].get("rotation", [0, 0, 0, 1]))
        yield nodes[name], "rotation", (rest * Rotation.from_euler("xyz", angles)).as_quat(), "VEC4"
    path = np.stack([0.1 * share, 0.05 * share, 0.01 * frame], axis=1)
    yield nodes["Hips"], "translation", path + fields["nodes"][nodes["Hips"]].get("translation", [0, 0, 0]), "VEC3"
    for index, node in enumerate(fields["nodes"]):
        targets = fields["meshes"][node["mesh"]]["primitives"][0].get("targets", []) if "mesh" in node else []
        if targets:
            weights = np.zeros((len(frame), len(targets)))
            weights[:, 1] = 0.5 + 0.5 * share
            yield index, "weights", weights.reshape(-1), "SCALAR"
            return


def imported(path: Path) -> None:
    """The character in an empty scene."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps = FPS
    bpy.ops.import_scene.gltf(filepath=str(path))
    first, last = map(round, armature().animation_data.action.frame_range)
    scene.frame_start, scene.frame_end = first, last
    scene.frame_set((first + last) // 2)  # models are then written as they are in this frame


def armature() -> Any:
    (rig,) = [thing for thing in bpy.data.objects if thing.type == "ARMATURE"]
    return rig


def posed(thing: Any) -> np.ndarray:
    """Vertices of an object in the current frame, in the axes of glTF [m]."""
    evaluated = thing.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = evaluated.to_mesh()
    points = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", points)
    world = np.array(evaluated.matrix_world)
    evaluated.to_mesh_clear()
    return (points.reshape(-1, 3).astype(float) @ world[:3, :3].T + world[:3, 3]) @ Y_UP.T


def weights(thing: Any, names: list[str]) -> np.ndarray:
    """Shares of joints in the vertices of an object [v, j]."""
    dense = np.zeros((len(thing.data.vertices), len(names)))
    place = {group.index: names.index(group.name) for group in thing.vertex_groups if group.name in names}
    for vertex in thing.data.vertices:
        for entry in vertex.groups:
            if entry.group in place:
                dense[vertex.index, place[entry.group]] = entry.weight
    return dense / np.maximum(dense.sum(axis=1, keepdims=True), 1e-12)


def save_reference(path: Path) -> None:
    """Import a file into Blender, and save what it is there beside it (.npz)."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.fbx(filepath=str(path))
    scene, rig = bpy.context.scene, armature()
    bones = list(rig.pose.bones)
    meshes = [thing for thing in bpy.data.objects if thing.type == "MESH"]
    names = [bone.name for bone in bones]
    arrays: dict[str, Any] = {"joint_names": names, "mesh_names": [thing.name for thing in meshes], "joints": []}
    vertices: dict[str, list[np.ndarray]] = {thing.name: [] for thing in meshes}
    rate = scene.render.fps / scene.render.fps_base
    first = round(rig.animation_data.action.frame_range[0])
    arrays["seconds"] = (np.array(FRAMES) - 1) / rate
    for frame in FRAMES:
        scene.frame_set(first + frame - 1)
        arrays["joints"].append([Y_UP @ np.array(rig.matrix_world @ bone.head) for bone in bones])
        for thing in meshes:
            vertices[thing.name].append(posed(thing))
    arrays |= {f"vertices {name}": np.array(found) for name, found in vertices.items()}
    arrays |= {f"weights {thing.name}": weights(thing, names) for thing in meshes}
    np.savez_compressed(path.with_suffix(".npz"), **arrays)


def export(path: Path, folder: Path) -> None:
    """All FBX files of a character, and what Blender has of them."""
    imported(path)
    for name, options in EXPORTS.items():
        settings = {"add_leaf_bones": False, "bake_anim_use_nla_strips": False, **options}
        bpy.ops.export_scene.fbx(filepath=str(folder / f"{name}.fbx"), **settings)
    for name in EXPORTS:
        save_reference(folder / f"{name}.fbx")


def differences(path: Path) -> tuple[float, float, float, float]:
    """Largest differences of a file here and in Blender: vertices, joints [m] and weights; and the way of the head."""
    from quaffure.body.character import Character
    from quaffure.body.character_animation import poses_at
    from quaffure.io.fbx_animation import read_animations
    from quaffure.io.fbx_document import read_document
    from quaffure.io.fbx_mesh import read_meshes
    from quaffure.io.fbx_nodes import in_bind_pose, read_scene
    from quaffure.io.fbx_records import open_fbx
    from quaffure.io.fbx_skin import bind_pose, read_clusters

    # As `read_fbx`, but that it keeps which vertices of the file those of the meshes are.
    document = read_document(open_fbx(path))
    scene = read_scene(document)
    clusters = read_clusters(document, scene)
    nodes = in_bind_pose(scene, bind_pose(document, scene, clusters))
    meshes = read_meshes(document, scene, nodes, clusters)
    animation = max(read_animations(document, scene, nodes, meshes), key=lambda each: len(each.channels))
    character = Character(nodes, tuple(found.mesh for found in meshes), (animation,), str(path))
    with np.load(path.with_suffix(".npz")) as expected:
        (poses,) = poses_at(character, animation, animation.span[0] + expected["seconds"])
        columns = [nodes.names.index(name) for name in expected["joint_names"]]
        joints = np.linalg.norm(poses.world[:, columns][..., :3, 3] - expected["joints"], axis=-1).max()
        assert {found.mesh.name for found in meshes} == {*expected["mesh_names"]}
        apart, shares = [], []
        for found in meshes:
            mesh, source = found.mesh, found.geometry.source
            for frame, theirs in enumerate(expected[f"vertices {mesh.name}"]):
                shapes = poses.morph_weights.get(mesh.node)
                own = mesh.posed(poses.world[frame], None if shapes is None else shapes[frame])
                apart.append(np.linalg.norm(own - theirs[source], axis=1).max())
            dense = np.zeros((len(mesh.vertices), len(nodes)))
            np.add.at(dense, (np.arange(len(dense))[:, None], mesh.joints), mesh.weights)
            theirs = expected[f"weights {mesh.name}"][source]
            assert mesh.is_rigid or np.abs(theirs.sum(axis=1) - 1).max() < MOST_WEIGHT
            shares.append(0.0 if mesh.is_rigid else np.abs(dense[:, columns] - theirs).max())
    moved = np.ptp(poses.world[:, nodes.names.index("Head"), :3, 3], axis=0).max()
    return float(max(apart)), float(joints), float(max(shares)), float(moved)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("character", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--python", default=sys.executable, help="a Python with bpy and numpy")
    options = parser.parse_args()
    if bpy is not None:
        export(options.character, options.folder)
        return 0
    if subprocess.run([options.python, "-c", "import bpy"], capture_output=True).returncode:
        print(f"{options.python} has no bpy: nothing was compared")
        return 0
    options.folder.mkdir(parents=True, exist_ok=True)
    (options.folder / "character.glb").write_bytes(animated(options.character))
    subprocess.run([options.python, __file__, options.folder / "character.glb", options.folder], check=True)
    is_apart = False
    for name in EXPORTS:
        vertices, joints, shares, moved = differences(options.folder / f"{name}.fbx")
        print(f"{name}: vertices within {1e3 * vertices:.4f} mm, joints {1e3 * joints:.4f} mm, weights {shares:.1e}; "
              f"the head moves by {1e3 * moved:.0f} mm")  # fmt: skip
        is_apart |= max(vertices, joints) > MOST_DISTANCE or shares > MOST_WEIGHT
    return int(is_apart)


if __name__ == "__main__":
    sys.exit(main())
