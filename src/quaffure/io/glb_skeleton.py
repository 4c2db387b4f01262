"""The body of a .glb, skinned to its skeleton, which plays the poses of a drape."""

import numpy as np
from jaxtyping import Float, Float32, Int
from scipy.spatial.transform import Rotation

from quaffure.hair.export_clip import ExportClip
from quaffure.io.glb_asset import GlbAsset, in_gltf

HEAD = "Head"
INFLUENCES = 4
"""Joints that move a vertex; pages read no more."""


class SkinnedBody:
    """Joints of a clip with a binding, in every frame.

    Raises:
        ValueError: its skeleton has no head.
    """

    def __init__(self, clip: ExportClip) -> None:
        assert clip.binding is not None
        self._clip, self._skeleton = clip, clip.binding.skeleton
        self._head = self._skeleton.names.index(HEAD)

    def in_head(self, frame: int, points: Float[np.ndarray, "p 3"]) -> Float32[np.ndarray, "p 3"]:
        """Points of a frame in the frame of the head and relative to its joint [m]."""
        rotations, positions = self._skeleton.posed(self._pose(frame), self._translation(frame))
        return ((points - positions[self._head]) @ rotations[self._head]).astype(np.float32)

    def add_to(self, asset: GlbAsset, mesh: int) -> int:
        """Add the joints, their motion, and a body that they move.

        Returns:
            The node of the head.
        """
        skeleton = self._skeleton
        bones = skeleton.rest_joints.copy()
        for joint, parent in enumerate(skeleton.parents):
            if parent >= 0:
                bones[joint] -= skeleton.rest_joints[parent]
        nodes = [asset.add_node(name, translation=bone) for name, bone in zip(skeleton.names, in_gltf(bones).tolist())]
        for joint, parent in enumerate(skeleton.parents):
            if parent >= 0:
                asset.nodes[nodes[parent]].setdefault("children", []).append(nodes[joint])
            else:
                asset.add_root(nodes[joint])
        self._add_motion(asset, nodes)
        joints, weights = _strongest(skeleton.skin_joints, skeleton.skin_weights)
        asset.add_attribute(mesh, "JOINTS_0", joints.astype(np.uint16))
        asset.add_attribute(mesh, "WEIGHTS_0", weights)
        inverse = np.tile(np.eye(4, dtype=np.float32), (len(nodes), 1, 1))
        inverse[:, 3, :3] = -in_gltf(skeleton.rest_joints)  # columns one after another
        asset.skins.append({"joints": nodes, "inverseBindMatrices": asset.add(inverse.reshape(-1, 16))})
        asset.add_root(asset.add_node(asset.meshes[mesh]["name"], mesh=mesh, skin=0))
        return nodes[self._head]

    def _add_motion(self, asset: GlbAsset, nodes: list[int]) -> None:
        frames, times = self._clip.frames, self._clip.times
        pose = np.stack([self._pose(frame) for frame in frames])
        for joint, node in enumerate(nodes):
            rotations = Rotation.from_rotvec(in_gltf(pose[:, joint]).astype(float)).as_quat()
            # Of the two quaternions of a rotation the one near the last frame's, or viewers would go the long way.
            for frame in range(1, len(rotations)):
                if rotations[frame] @ rotations[frame - 1] < 0:
                    rotations[frame] *= -1
            asset.add_channel(node, "rotation", times, rotations.astype(np.float32))
        if self._clip.sequence.body_translation is not None:
            path = self._skeleton.rest_joints[0] + np.stack([self._translation(frame) for frame in frames])
            asset.add_channel(nodes[0], "translation", times, in_gltf(path))

    def _pose(self, frame: int) -> Float[np.ndarray, "j 3"]:
        return self._clip.sequence.body_pose[frame].reshape(-1, 3).astype(float)

    def _translation(self, frame: int) -> Float[np.ndarray, "3"]:
        path = self._clip.sequence.body_translation
        return np.zeros(3) if path is None else path[frame].astype(float)


def _strongest(
    joints: Int[np.ndarray, "v w"], weights: Float[np.ndarray, "v w"]
) -> tuple[Int[np.ndarray, "v 4"], Float32[np.ndarray, "v 4"]]:
    """The joints that move each vertex most, and their shares, which sum to 1."""
    order = np.argsort(-weights, axis=1, kind="stable")[:, :INFLUENCES]
    chosen = np.take_along_axis(weights, order, axis=1)
    return np.take_along_axis(joints, order, axis=1), (chosen / chosen.sum(axis=1, keepdims=True)).astype(np.float32)
