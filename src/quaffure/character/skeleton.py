"""The skeleton of a character on the joints of the body.

Joints that the file has are where the file has them. Others are placed between the ones above and below them, at the
share of the way that they have in the shipped body, or else from the one above, in proportion. Arms and legs are then
turned from the file's rest pose to the body's, by the rotation with which its motion is retargeted
(`quaffure.body.retargeting`), so that a pose means the same on every body.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from quaffure.body.body_model import BodyModel
from quaffure.body.bvh_clip import BvhClip
from quaffure.body.character import Character, CharacterNodes, SkinnedMesh
from quaffure.body.joint_map import CHAINS, JointMap
from quaffure.body.joint_names import automatic_joint_map, check_joint_map, heads
from quaffure.body.retargeting import rest_alignment
from quaffure.body.source_skeleton import source_skeleton
from quaffure.character.collision_surface import check_extent
from quaffure.errors import InputError

HEIGHTS = (0.4, 2.6)
"""Heights that a character may have; where metres give another one, the unit is another one [m]."""
UNITS = (1.0, 0.01, 0.0254, 0.001)
ENDS = ("Hips", "Head")
"""Joints of the body that a character's place and size follow, and so must be joints of its own."""
NEAR = 0.02
"""Distance between joints that are in one place, in heights."""
SCENE = ""
"""Name of the joint that is above all roots of a file."""


@dataclass(frozen=True)
class FittedSkeleton:
    """The body's joints in a character.

    Attributes:
        metres: in a file unit.
        body_from_file: rotation from the file's axes to the body's.
        origin: the file's point that is the origin of the body's space [file units].
        file_joints: joints in the file's rest pose, in the body's space [m].
        rest_joints: the same in the body's own rest pose [m].
        rest_rotations: rotation of each joint from the first to the second.
        node_joints: joint of the body that moves what each node of the file moves.
        joint_nodes: node of each joint of the body, an empty text for one that was placed.
        joint_map: that it was made by.
    """

    metres: float
    body_from_file: Float[np.ndarray, "3 3"]
    origin: Float[np.ndarray, "3"]
    file_joints: Float[np.ndarray, "27 3"]
    rest_joints: Float[np.ndarray, "27 3"]
    rest_rotations: Float[np.ndarray, "27 3 3"]
    node_joints: Int[np.ndarray, " j"]
    joint_nodes: tuple[str, ...]
    joint_map: JointMap

    def in_body_space(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Points of the file's scene in the body's space, in the file's rest pose [m]."""
        return self.metres * (points - self.origin) @ self.body_from_file.T

    def dense_weights(self, joints: Int[np.ndarray, "v w"], weights: Float[np.ndarray, "v w"]) -> np.ndarray:
        """Share of each joint of the body in vertices that nodes of the file move [v, 27]."""
        dense = np.zeros((len(joints), len(self.rest_joints)))
        np.add.at(dense, (np.arange(len(joints))[:, None], self.node_joints[joints]), weights)
        return dense / np.maximum(dense.sum(1, keepdims=True), 1e-12)

    def to_rest_pose(self, points: Float[np.ndarray, "v 3"], weights: Float[np.ndarray, "v 27"]) -> np.ndarray:
        """Points in the file's rest pose, moved to the body's by linear blend skinning [m]."""
        moved = np.zeros_like(points)
        for joint in np.flatnonzero(weights.any(0)):
            offset = (points - self.file_joints[joint]) @ self.rest_rotations[joint].T + self.rest_joints[joint]
            moved += weights[:, joint, None] * offset
        return moved


def fit_skeleton(character: Character, template: BodyModel, joint_map: JointMap | None = None) -> FittedSkeleton:
    """The body's joints in a character.

    Args:
        template: the shipped body, whose rest pose and proportions count.
        joint_map: which joints are which; by their names without one.

    Raises:
        InputError: no head or two, another required joint missing, two of one name, a map with a share of two for one
            of `ENDS`, a figure that does not stand, or no meshes.
    """
    clip = rest_clip(character)
    if joint_map is None:
        _check_one_head(clip)
        joint_map = _map_by_names(character, clip)
    else:
        check_joint_map(joint_map, clip)
    between = [f"{joint} = {joint_map[joint]}" for joint in ENDS if joint_map[joint].second is not None]
    if between:
        raise InputError(character.source, f"one joint each for {' and '.join(ENDS)}", ", ".join(between))
    source = source_skeleton(clip, joint_map)
    turn, names = source.body_from_file, character.nodes.names
    own = {name: joint_map[name].first for name in template.joint_names if name in joint_map}
    own = {name: first for name, first in own.items() if joint_map[name].second is None}
    mapped = [names.index(name) for name in own.values()]
    metres = _metres_per_unit(character, turn, character.nodes.world[mapped, :3, 3], template)
    positions = metres * character.nodes.world[:, :3, 3] @ turn.T
    found = {joint: positions[names.index(name)] for joint, name in own.items()}
    aligned = {joint: rest_alignment(joint, source, template).numpy() for joint in source.bones}
    rotations = _rest_rotations(joint_map, aligned, template)
    file_joints, rest_joints = _placed(found, rotations, template)
    fitted = FittedSkeleton(
        metres, turn, np.zeros(3), file_joints, rest_joints, rotations, _node_joints(character.nodes, own, template),
        tuple(own.get(name, "") for name in template.joint_names), joint_map,
    )  # fmt: skip
    return _on_ground(fitted, character, template)


def _check_one_head(clip: BvhClip) -> None:
    """Refuse a file of several figures, of which names would take one.

    Raises:
        InputError: joints of a head in several places.
    """
    places = {joint: clip.rest_position(joint) for joint in heads(clip)}
    height = float(np.ptp([clip.rest_position(joint) for joint in range(len(clip.joint_names))], axis=0).max())
    # Meshes with a copy each of one skeleton have their heads in one place.
    apart = [j for j, place in places.items() if np.linalg.norm(place - next(iter(places.values()))) > NEAR * height]
    if apart:
        names = " and ".join(clip.joint_names[joint] for joint in (next(iter(places)), *apart))
        expected = (
            "a file of one figure, or --joints map.toml of one (quaffure inspect FILE --save-joints map.toml writes a "
            "table to edit)"
        )
        raise InputError(clip.source, expected, f"{len(apart) + 1} heads: {names} for Head")


def _map_by_names(character: Character, clip: BvhClip) -> JointMap:
    """`automatic_joint_map`; where there is none and no mesh is skinned, that is what is wrong."""
    meshes = _figure(character)
    try:
        return automatic_joint_map(clip)
    except InputError as error:
        if not all(mesh.is_rigid for mesh in meshes):
            raise
        found = f"none that is: {', '.join(dict.fromkeys(mesh.name for mesh in meshes))}"
        raise InputError(character.source, "a skinned mesh, with joints and weights", found) from error


def rest_clip(character: Character) -> BvhClip:
    """The joints of a character as the skeleton of a motion file of one frame, in which it is at rest."""
    nodes, joints = character.nodes, character.joints
    positions = nodes.world[joints, :3, 3]
    place = {joint: index for index, joint in enumerate(joints)}
    parents = np.array([place.get(int(parent), -1) + 1 for parent in nodes.parents[joints]])
    offsets = positions - np.concatenate([np.zeros((1, 3)), positions])[parents]
    return BvhClip(
        joint_names=(SCENE, *(nodes.names[joint] for joint in joints)),
        parents=np.concatenate([[-1], parents]),
        offsets=np.concatenate([np.zeros((1, 3)), offsets]),
        channels=((),) * (len(joints) + 1),
        values=np.zeros((1, 0)),
        frame_time=1.0,
        source=character.source,
    )


def _metres_per_unit(
    character: Character, turn: Float[np.ndarray, "3 3"], joints: Float[np.ndarray, "j 3"], template: BodyModel
) -> float:
    """1, as glTF asks, where it gives a human height; or else the known unit whose height is nearest to the template's
    in proportion, or one that gives the template's."""
    for mesh in (mesh for mesh in _figure(character) if not mesh.is_rigid):
        check_extent(mesh.name, mesh.vertices, joints, character.source)
    height = float(np.ptp(np.concatenate([mesh.vertices @ turn[2] for mesh in _figure(character)])))
    if not height > 0:
        raise InputError(character.source, "meshes of a standing figure", "a height of 0")
    usual = float(np.ptp(template.rest_vertices[:, 2].numpy()))
    fitting = [unit for unit in UNITS if HEIGHTS[0] < unit * height < HEIGHTS[1]]
    if UNITS[0] in fitting:
        return UNITS[0]
    return min(fitting, key=lambda unit: abs(np.log(unit * height / usual)), default=usual / height)


def _figure(character: Character) -> list[SkinnedMesh]:
    """The meshes that show how tall a character is: those with a skin, as others may be props; all without any."""
    meshes = [mesh for mesh in character.meshes if len(mesh.vertices)]
    if not meshes:
        raise InputError(character.source, "a character with meshes of triangles", "none")
    return [mesh for mesh in meshes if not mesh.is_rigid] or meshes


def _rest_rotations(
    joint_map: JointMap, aligned: dict[str, np.ndarray], template: BodyModel
) -> Float[np.ndarray, "27 3 3"]:
    """Rotation of each joint from the file's rest pose to the body's; joints that the file lacks follow their parents,
    but feet, whose rotation motion leaves alone too."""
    rotations = np.empty((len(template.joint_names), 3, 3))
    for joint, (name, parent) in enumerate(zip(template.joint_names, template.joint_parents)):
        if name in aligned:
            rotations[joint] = aligned[name].T
        elif parent < 0 or name.endswith("Foot") or (name in joint_map and not name.endswith("FingerBase")):
            rotations[joint] = np.eye(3)
        else:
            rotations[joint] = rotations[parent]
    return rotations


def _placed(
    found: dict[str, np.ndarray], rotations: Float[np.ndarray, "27 3 3"], template: BodyModel
) -> tuple[Float[np.ndarray, "27 3"], Float[np.ndarray, "27 3"]]:
    """Joints in the file's rest pose and in the body's [m]."""
    own, names = template.rest_joints.double().numpy(), template.joint_names
    scale = np.linalg.norm(found["Head"] - found["Hips"]) / np.linalg.norm(own[names.index("Head")] - own[0])
    in_file, at_rest = np.empty_like(own), np.empty_like(own)
    in_file[0] = at_rest[0] = found["Hips"]
    for joint, parent in list(enumerate(template.joint_parents))[1:]:
        if names[joint] in found:
            in_file[joint] = found[names[joint]]
        elif (below := next((end for end in _chain(joint, template) if names[end] in found), None)) is not None:
            length = [np.linalg.norm(own[joint] - own[end]) for end in (parent, below)]
            in_file[joint] = in_file[parent] + length[0] / sum(length) * (found[names[below]] - in_file[parent])
        else:
            in_file[joint] = in_file[parent] + scale * rotations[parent].T @ (own[joint] - own[parent])
        at_rest[joint] = at_rest[parent] + rotations[parent] @ (in_file[joint] - in_file[parent])
    return in_file, at_rest


def _chain(joint: int, template: BodyModel) -> list[int]:
    """The joints of the trunk, or of the limb, that a joint carries."""
    chain = next((chain for chain in CHAINS if template.joint_names[joint] in chain[1:-1]), ())
    after = chain.index(template.joint_names[joint]) + 1 if chain else 0
    return [template.joint_names.index(name) for name in chain[after:]]


def _node_joints(nodes: CharacterNodes, own: dict[str, str], template: BodyModel) -> Int[np.ndarray, " j"]:
    """For every node the joint of its nearest ancestor that is one of the body's; the Hips without any."""
    joint_of = {node: template.joint_names.index(joint) for joint, node in reversed(own.items())}
    result = np.zeros(len(nodes.names), dtype=np.int64)
    for node, parent in enumerate(nodes.parents):
        inherited = result[parent] if parent >= 0 else 0
        result[node] = joint_of.get(nodes.names[node], inherited)
    return result


def _on_ground(fitted: FittedSkeleton, character: Character, template: BodyModel) -> FittedSkeleton:
    """The same with its hips above the origin as in the template, and its soles at z = 0 in the body's rest pose."""
    lowest = min(
        fitted.to_rest_pose(
            fitted.in_body_space(mesh.vertices), fitted.dense_weights(mesh.joints, mesh.weights)
        )[:, 2].min()
        for mesh in _figure(character)
    )  # fmt: skip
    offset = np.array([*(fitted.rest_joints[0] - template.rest_joints[0].numpy())[:2], lowest])
    return replace(
        fitted,
        origin=offset @ fitted.body_from_file / fitted.metres,
        file_joints=fitted.file_joints - offset,
        rest_joints=fitted.rest_joints - offset,
    )
