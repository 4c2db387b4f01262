"""Characters made of the body of the package: another rig, rest pose, unit and axes, and another head."""

from dataclasses import replace

import numpy as np
import torch

from quaffure.body import BodyModel, Character, CharacterNodes, SkinnedMesh
from quaffure.body.character import Skin
from quaffure.types import Float

MIXAMO = {
    "Hips": "Hips", "Spine": "LowerBack", "Spine1": "Spine", "Spine2": "Spine1", "Neck": "Neck1", "Head": "Head",
    **{f"{side}{joint}": f"{side}{joint}" for side in ("Left", "Right")
       for joint in ("Shoulder", "Arm", "ForeArm", "Hand", "UpLeg", "Leg", "Foot", "ToeBase")},
    **{f"{side}HandMiddle1": f"{side}FingerBase" for side in ("Left", "Right")},
}  # fmt: skip
"""Joints of a Mixamo rig, and those of the body."""
ARM_ANGLE = 0.72
"""From the rest pose to a T pose [rad]."""
Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""From the body's axes to those of glTF."""


REFERENCE_GRID = 0.006
"""Cells of the surface in tests, twice as large as by default [m]."""


def t_pose(body: BodyModel) -> Float[torch.Tensor, "1 81"]:
    pose = torch.zeros(1, 27, 3)
    for side, sign in (("Left", -1.0), ("Right", 1.0)):
        pose[0, body.joint_names.index(f"{side}Arm"), 1] = sign * ARM_ANGLE
    return pose.flatten(1)


def character(
    body: BodyModel,
    names: dict[str, str] = MIXAMO,
    prefix: str = "mixamorig:",
    head_scale: tuple[float, float, float] = (1.0, 1.0, 1.0),
    centimetres: bool = True,
) -> Character:
    """The body in a T pose, y up, on a rig that has fewer joints, whose frames are not aligned with the world's.

    Args:
        names: joints of the rig, parents first, and the body's of each; what others move, the nearest above moves.
        head_scale: of the head about its joint, along the body's axes, fading out along the neck.
    """
    posed = body.pose(t_pose(body), torch.zeros(1, 10))
    vertices = stretched_head(body, posed.vertices[0], head_scale).double().numpy()
    scale = 100.0 if centimetres else 1.0
    own = [body.joint_names.index(joint) for joint in names.values()]
    node_of = np.empty(27, dtype=np.int64)
    for joint, parent in enumerate(body.joint_parents):
        node_of[joint] = own.index(joint) if joint in own else node_of[parent]
    parents = np.array([-1 if parent < 0 else node_of[parent] for parent in np.array(body.joint_parents)[own]])
    positions = scale * posed.joint_positions[0].double().numpy()[own] @ Y_UP.T
    turns = np.random.default_rng(5).normal(size=(len(own), 4))
    nodes = nodes_at([f"{prefix}{name}" for name in names], parents, positions, turns)
    vertices = scale * vertices @ Y_UP.T
    mesh = mesh_of("Body", vertices, body.faces.numpy(), nodes, node_of[body.skin_joints.numpy()], body.skin_weights)
    return Character(nodes, (mesh,), (), "character.glb")


def stretched_head(
    body: BodyModel, vertices: Float[torch.Tensor, "v 3"], scale: tuple[float, float, float]
) -> Float[torch.Tensor, "v 3"]:
    """Vertices of the body, those of the head scaled about its joint."""
    joint = body.joint_names.index("Head")
    share = body.dense_skin_weights[:, joint, None]
    centre = body.rest_joints[joint]
    return vertices + share * (torch.tensor(scale) - 1) * (vertices - centre)


def with_mesh(of: Character, mesh: SkinnedMesh) -> Character:
    return replace(of, meshes=(*of.meshes, mesh))


def mesh_of(
    name: str, vertices: np.ndarray, faces: np.ndarray, nodes: CharacterNodes, joints: np.ndarray, weights: torch.Tensor
) -> SkinnedMesh:
    """A mesh at rest that nodes move."""
    skin = Skin(np.arange(len(nodes)), np.linalg.inv(nodes.world))
    return SkinnedMesh(
        name, 0, (f"{name}Material",), np.zeros(len(faces), dtype=int), vertices, vertices, faces, skin, False, joints,
        weights.double().numpy(),
    )  # fmt: skip


def nodes_at(
    names: list[str], parents: np.ndarray, positions: Float[np.ndarray, "j 3"], turns: Float[np.ndarray, "j 4"]
) -> CharacterNodes:
    """Nodes at places of the scene, in frames of any rotation."""
    from scipy.spatial.transform import Rotation

    world = Rotation.from_quat(turns)
    local, offsets = [], []
    for node, parent in enumerate(parents):
        above = world[parent].inv() if parent >= 0 else Rotation.identity()
        local.append((above * world[node]).as_quat())
        offsets.append(above.apply(positions[node] - (positions[parent] if parent >= 0 else 0)))
    return CharacterNodes(tuple(names), parents, np.array(offsets), np.array(local), np.ones((len(names), 3)))
