"""A motion capture clip of a BVH file: its own skeleton, Euler angles, units and axes."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

CHANNEL_NAMES = ("Xposition", "Yposition", "Zposition", "Xrotation", "Yrotation", "Zrotation")


@dataclass(frozen=True)
class BvhClip:
    """Skeleton and channel values; y is up in nearly all files, lengths are in the file's unit.

    Attributes:
        joint_names: names, parents before children.
        parents: index of each joint's parent, -1 for the root.
        offsets: rest position of each joint relative to its parent [file units].
        channels: for each joint the names of its channels, in the order of `values` (see `CHANNEL_NAMES`).
        values: channel values of each frame, all joints one after another [file units, degrees].
        frame_time: seconds from one frame to the next.
        source: the file, for messages.
        ends: offset of each joint's End Site [file units], NaN where it has none. Many programs write a made-up one.
    """

    joint_names: tuple[str, ...]
    parents: Int[np.ndarray, " j"]
    offsets: Float[np.ndarray, "j 3"]
    channels: tuple[tuple[str, ...], ...]
    values: Float[np.ndarray, "f c"]
    frame_time: float
    source: str
    ends: Float[np.ndarray, "j 3"] | None = None

    @property
    def fps(self) -> float:
        return 1.0 / self.frame_time

    def ancestors(self, joint: int) -> list[int]:
        """The joint itself, its parent, and so on to the root."""
        chain = [joint]
        while self.parents[chain[-1]] >= 0:
            chain.append(int(self.parents[chain[-1]]))
        return chain

    def rest_position(self, joint: int) -> Float[np.ndarray, "3"]:
        """Position of a joint with all rotations zero, from the root's [file units]."""
        return self.offsets[self.ancestors(joint)[:-1]].sum(0)

    def has_path(self, joint: int) -> bool:
        """Whether a joint or one above it has three position channels."""
        return any(set(CHANNEL_NAMES[:3]) <= set(self.channels[j]) for j in self.ancestors(joint))

    def translations(self, joint: int) -> Float[np.ndarray, "f 3"]:
        """Position of a joint in its parent's frame [file units]: the channels where it has them, else the offset.

        Below the root some programs write zeros there, meaning the offset.
        """
        names = self.channels[joint]
        if set(CHANNEL_NAMES[:3]) <= set(names):
            first = sum(map(len, self.channels[:joint]))
            positions = self.values[:, [first + names.index(name) for name in CHANNEL_NAMES[:3]]]
            if joint == 0 or positions.any():
                return positions
        return np.broadcast_to(self.offsets[joint], (len(self.values), 3))

    def world_positions(self, joint: int, world_rotations: Float[np.ndarray, "f j 3 3"]) -> Float[np.ndarray, "f 3"]:
        """Position of a joint in the file's world [file units].

        Args:
            world_rotations: as from the method of that name.
        """
        position = np.zeros((len(self.values), 3))
        for link in self.ancestors(joint):
            offset, parent = self.translations(link), int(self.parents[link])
            position = position + (
                offset if parent < 0 else np.einsum("fij,fj->fi", world_rotations[:, parent], offset)
            )
        return position

    def local_rotations(self) -> Float[np.ndarray, "f j 3 3"]:
        """Rotation of each joint relative to its parent; identity for a joint without rotation channels.

        The first rotation channel is the outermost: channels `Zrotation Xrotation Yrotation` mean Rz Rx Ry.
        """
        rotations = np.tile(np.eye(3), (len(self.values), len(self.joint_names), 1, 1))
        first = 0
        for joint, channels in enumerate(self.channels):
            columns = [first + i for i, name in enumerate(channels) if name.endswith("rotation")]
            axes = "".join(channels[c - first][0] for c in columns)
            if axes:
                rotations[:, joint] = Rotation.from_euler(axes, self.values[:, columns], degrees=True).as_matrix()
            first += len(channels)
        return rotations

    def world_rotations(self) -> Float[np.ndarray, "f j 3 3"]:
        """Rotation of each joint from its rest frame (aligned with the file's axes) to the file's world."""
        rotations = self.local_rotations()
        for joint, parent in enumerate(self.parents):
            if parent >= 0:
                rotations[:, joint] = rotations[:, parent] @ rotations[:, joint]
        return rotations
