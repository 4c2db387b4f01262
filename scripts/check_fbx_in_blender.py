"""Compare our reader of FBX with Blender's: `check_fbx_in_blender.py CHARACTER.glb FOLDER --python PYTHON`.

PYTHON is one with bpy and numpy, which is run with this script; without bpy nothing is compared. In Blender the
character is given an animation and exported as FBX in several ways, and each file is imported again. Our reader gets
the same files: vertices of all meshes and joints in some frames, and weights, are compared. Prints the largest
differences, and fails beyond 0.1 mm or 1e-5 of a weight. The files stay in FOLDER.
"""

import argparse
import json
import math
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

try:
    import bpy
except ImportError:
    bpy = None

MOST_DISTANCE, MOST_WEIGHT = 1e-4, 1e-5  # m, share
FPS, FRAMES = 30, (1, 6, 16, 31)
"""Frames that have keys in every file: between sparse ones Blender joins quaternions, FBX angles."""
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


def unpack(path: Path, out: Path) -> None:
    """Write a .glb without its compression by meshopt, which Blender does not read."""
    from quaffure.io.gltf_accessor import MESHOPT, GltfArrays
    from quaffure.io.gltf_document import open_gltf

    document = open_gltf(path)
    arrays, fields, binary = GltfArrays(document), dict(document.root.fields), bytearray()
    for index, view in enumerate(fields["bufferViews"]):
        binary += bytes(-len(binary) % 4)
        content = arrays._view(index).tobytes()
        view |= {"buffer": 0, "byteOffset": len(binary), "byteLength": len(content)}
        view.pop("extensions", None)
        binary += content
    binary += bytes(-len(binary) % 4)
    fields["buffers"] = [{"byteLength": len(binary)}]
    for key in ("extensionsUsed", "extensionsRequired"):
        fields[key] = [name for name in fields.get(key, []) if name != MESHOPT]
    text = json.dumps(fields).encode()
    text += b" " * (-len(text) % 4)
    parts = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(binary), 0x004E4942) + binary
    out.write_bytes(struct.pack("<III", 0x46546C67, 2, 12 + len(parts)) + parts)


def animate(path: Path) -> None:
    """Import the character into an empty scene, and animate its joints and a shape of each mesh."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=str(path))
    scene = bpy.context.scene
    scene.render.fps, scene.frame_start, scene.frame_end = FPS, FRAMES[0], FRAMES[-1]
    rig = armature()
    for frame in range(FRAMES[0], FRAMES[-1] + 1, 3):
        share = math.sin(0.2 * frame)
        for name, angle in TURNED.items():
            bone = rig.pose.bones[name]
            bone.rotation_mode = "XYZ"
            bone.rotation_euler = (share * angle, 0.5 * angle * math.cos(0.3 * frame), 0.3 * share * angle)
            bone.keyframe_insert("rotation_euler", frame=frame)
        rig.pose.bones["Hips"].location = (0.1 * share, 0.2 * share, 0.01 * frame)
        rig.pose.bones["Hips"].keyframe_insert("location", frame=frame)
        for thing in (thing for thing in bpy.data.objects if thing.type == "MESH" and thing.data.shape_keys):
            key = thing.data.shape_keys.key_blocks[1]
            key.value = 0.5 + 0.5 * share
            key.keyframe_insert("value", frame=frame)
    scene.frame_set(FRAMES[2])  # models are then written as they are in this frame


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
    arrays["seconds"] = (np.array(FRAMES) - rig.animation_data.action.frame_range[0]) / rate
    for frame in FRAMES:
        scene.frame_set(frame)
        arrays["joints"].append([Y_UP @ np.array(rig.matrix_world @ bone.head) for bone in bones])
        for thing in meshes:
            vertices[thing.name].append(posed(thing))
    arrays |= {f"vertices {name}": np.array(found) for name, found in vertices.items()}
    arrays |= {f"weights {thing.name}": weights(thing, names) for thing in meshes}
    np.savez_compressed(path.with_suffix(".npz"), **arrays)


def export(path: Path, folder: Path) -> None:
    """All FBX files of a character, and what Blender has of them."""
    animate(path)
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
    unpack(options.character, options.folder / "character.glb")
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
