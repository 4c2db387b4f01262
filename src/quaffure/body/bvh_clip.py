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
    """

    joint_names: tuple[str, ...]
    parents: Int[np.ndarray, " j"]
    offsets: Float[np.ndarray, "j 3"]
    channels: tuple[tuple[str, ...], ...]
    values: Float[np.ndarray, "f c"]
    frame_time: float
    source: str

    @property
    def fps(self) -> float:
        return 1.0 / self.frame_time

    def root_positions(self) -> Float[np.ndarray, "f 3"] | None:
        """Position of the root in the file's world [file units]; None where it has not all three position channels."""
        names = self.channels[0]
        if not set(CHANNEL_NAMES[:3]) <= set(names):
            return None
        return self.values[:, [names.index(name) for name in CHANNEL_NAMES[:3]]]

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
