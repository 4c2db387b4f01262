"""The body with its armature and groom in Blender, and the pose of an armature as quaffure takes it."""

import json
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector

DEFAULT_PARENTS = {
    "Hips": "", "LHipJoint": "Hips", "LeftUpLeg": "LHipJoint", "LeftLeg": "LeftUpLeg", "LeftFoot": "LeftLeg",
    "LeftToeBase": "LeftFoot", "LowerBack": "Hips", "Spine": "LowerBack", "Spine1": "Spine",
    "LeftShoulder": "Spine1", "LeftArm": "LeftShoulder", "LeftForeArm": "LeftArm", "LeftHand": "LeftForeArm",
    "LeftFingerBase": "LeftHand", "Neck": "Spine1", "Neck1": "Neck", "Head": "Neck1", "RightShoulder": "Spine1",
    "RightArm": "RightShoulder", "RightForeArm": "RightArm", "RightHand": "RightForeArm",
    "RightFingerBase": "RightHand", "RHipJoint": "Hips", "RightUpLeg": "RHipJoint", "RightLeg": "RightUpLeg",
    "RightFoot": "RightLeg", "RightToeBase": "RightFoot",
}  # fmt: skip
"""Joints of the body in its order, and the parent of each."""
BONE_LENGTH = 0.06
HAIR_COLOUR, BODY_COLOUR = (0.15, 0.062, 0.025), (0.62, 0.50, 0.435)
"""Linear RGB."""
GROOM, SHAPE = "quaffure_groom", "quaffure_shape"
FRAMES_PER_SECOND = 30.0
"""Rate at which quaffure counts frames: a frame of the scene is a frame of its motion."""


def add_character(rig: Path, groom: str) -> tuple[bpy.types.Object, bpy.types.Object, bpy.types.Object]:
    """Body, armature and hair from the file of `quaffure rig`."""
    with np.load(rig, allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    name = json.loads(str(arrays["meta"]))["groom"]
    armature = _armature(arrays)
    body = _body(arrays, armature)
    hair = curves_object(f"{name} hair", arrays["strands"])
    hair.parent = armature
    hair.data.materials.append(material("Quaffure hair", HAIR_COLOUR, 0.35))
    body.data.materials.append(material("Quaffure skin", BODY_COLOUR, 0.6))
    hair[GROOM], hair[SHAPE] = groom, arrays["body_shape"].tolist()
    return body, armature, hair


def material(name: str, colour: tuple[float, float, float], roughness: float) -> bpy.types.Material:
    """A material of the scene, made where there is none of the name."""
    if name in bpy.data.materials:
        return bpy.data.materials[name]
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    surface = made.node_tree.nodes["Principled BSDF"].inputs
    surface["Base Color"].default_value, surface["Roughness"].default_value = (*colour, 1.0), roughness
    return made


def curves_object(name: str, strands: np.ndarray) -> bpy.types.Object:
    """Hair curves through vertices [S,N,3]."""
    curves = bpy.data.hair_curves.new(name)
    curves.add_curves([strands.shape[1]] * len(strands))
    set_strands(curves, strands)
    thing = bpy.data.objects.new(name, curves)
    bpy.context.scene.collection.objects.link(thing)
    return thing


def set_strands(curves: bpy.types.Curves, strands: np.ndarray) -> None:
    curves.points.foreach_set("position", np.ascontiguousarray(strands, dtype=np.float32).ravel())
    curves.points.foreach_set("radius", np.full(len(curves.points), 2e-4, np.float32))
    curves.update_tag()


def motion_of(armature: bpy.types.Object, frames: range) -> dict[str, np.ndarray]:
    """Poses of an armature in some frames: rotations of the body's joints relative to their parents, in axes of the
    armature, and the translation of the hips. Joints are bones of their names, with or without a prefix such as
    `mixamorig:`; others follow their parents.

    Raises:
        ValueError: no bone has the name of a joint.
    """
    scene, now = bpy.context.scene, bpy.context.scene.frame_current
    joints = list(DEFAULT_PARENTS)
    names = {bone.name.rpartition(":")[2]: bone.name for bone in armature.data.bones}
    if not any(joint in names for joint in joints):
        raise ValueError(f"expected bones named {', '.join(joints[:4])} ..., found none in {armature.name}")
    pose, path = np.zeros((len(frames), 3 * len(joints))), np.zeros((len(frames), 3))
    try:
        for row, frame in enumerate(frames):
            scene.frame_set(frame)
            posed = armature.evaluated_get(bpy.context.evaluated_depsgraph_get()).pose.bones
            world: dict[str, Matrix] = {}
            for index, joint in enumerate(joints):
                parent = world.get(DEFAULT_PARENTS[joint], Matrix.Identity(3))
                own = posed.get(names.get(joint, ""))
                rotation = parent if own is None else own.matrix.to_3x3() @ own.bone.matrix_local.to_3x3().inverted()
                world[joint] = rotation.normalized()
                axis, angle = (parent.transposed() @ world[joint]).to_quaternion().to_axis_angle()
                pose[row, 3 * index : 3 * index + 3] = Vector(axis) * angle
                if own is not None and not DEFAULT_PARENTS[joint]:
                    path[row] = own.matrix.translation - own.bone.matrix_local.translation
    finally:
        scene.frame_set(now)
    return {"body_pose": pose.astype(np.float32), "body_translation": path.astype(np.float32), "fps": FRAMES_PER_SECOND}


def _armature(arrays: dict[str, np.ndarray]) -> bpy.types.Object:
    thing = bpy.data.objects.new("Body armature", bpy.data.armatures.new("Body armature"))
    bpy.context.scene.collection.objects.link(thing)
    bpy.context.view_layer.objects.active = thing
    bpy.ops.object.mode_set(mode="EDIT")
    joints, parents = arrays["rest_joints"], arrays["joint_parents"]
    bones = []
    for name, head, parent in zip(arrays["joint_names"], joints, parents):
        bone = thing.data.edit_bones.new(str(name))
        children = joints[parents == len(bones)]
        along = children[0] - head if len(children) else head - joints[parent]
        length = np.linalg.norm(along)
        bone.head = head
        bone.tail = head + (along * max(BONE_LENGTH / length, 1.0) if length > 1e-6 else np.array([0, 0, BONE_LENGTH]))
        if parent >= 0:
            bone.parent = bones[parent]
        bones.append(bone)
    bpy.ops.object.mode_set(mode="OBJECT")
    return thing


def _body(arrays: dict[str, np.ndarray], armature: bpy.types.Object) -> bpy.types.Object:
    mesh = bpy.data.meshes.new("Body")
    mesh.from_pydata(arrays["body_vertices"].tolist(), [], arrays["body_faces"].tolist())
    uv = mesh.uv_layers.new(name="st")
    uv.data.foreach_set("uv", arrays["body_uv"].astype(np.float32).ravel())
    mesh.shade_smooth()
    thing = bpy.data.objects.new("Body", mesh)
    bpy.context.scene.collection.objects.link(thing)
    groups = [thing.vertex_groups.new(name=str(name)) for name in arrays["joint_names"]]
    for slot in range(arrays["skin_joints"].shape[1]):
        joints, weights = arrays["skin_joints"][:, slot], arrays["skin_weights"][:, slot]
        for vertex in np.flatnonzero(weights > 0).tolist():
            groups[joints[vertex]].add([vertex], float(weights[vertex]), "ADD")
    thing.parent = armature
    modifier = thing.modifiers.new("Armature", "ARMATURE")
    modifier.object = armature
    return thing
