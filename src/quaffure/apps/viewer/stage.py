"""What the live page shows, as plain state that can be draped without a browser."""

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numpy as np
import torch

from quaffure.benchmark.metrics import measure
from quaffure.body.body_model import SHAPE_COUNT, BodyModel
from quaffure.body.motion import Motion, joint_matrices, pose_from_matrices
from quaffure.drape_motion import bodies_of, drape_motion
from quaffure.draper import Draper
from quaffure.errors import InputError
from quaffure.geometry.rotation import matrix_from_axis_angle
from quaffure.geometry.signed_distance import signed_distance
from quaffure.hair.drape_sequence import DrapeSequence
from quaffure.hair.groom import Groom
from quaffure.model.neural import NeuralDraper
from quaffure.types import BodyPose, Bool, Float

Degrees = tuple[float, float, float]
NO_TURN: Degrees = (0.0, 0.0, 0.0)
MEAN_SHAPE = (0.0,) * SHAPE_COUNT


@dataclass(frozen=True, eq=False)
class Stage:
    """A groom on a body in one frame of a clip, and what settles it there.

    Attributes:
        motion: the clip.
        frame: of the clip.
        joint_turns: rotation vectors about the axes of the rest pose, by joint, on top of the clip's pose [degrees].
        body_shape: beta [standard deviations].

    Raises:
        InputError: a frame outside of the clip, a joint that the body does not have, or not ten shape coefficients.
    """

    body: BodyModel
    groom: Groom
    motion: Motion
    draper: Draper
    frame: int = 0
    joint_turns: Mapping[str, Degrees] = field(default_factory=dict)
    body_shape: tuple[float, ...] = MEAN_SHAPE

    def __post_init__(self) -> None:
        if not 0 <= self.frame < len(self.motion):
            raise InputError("frame", f"0 to {len(self.motion) - 1} of {self.motion.name}", f"{self.frame}")
        if len(self.body_shape) != SHAPE_COUNT:
            raise InputError("body shape", f"{SHAPE_COUNT} coefficients", f"{len(self.body_shape)}")
        for joint in self.joint_turns:
            if joint not in self.body.joint_names:
                raise InputError("joint", f"one of {', '.join(self.body.joint_names)}", f"'{joint}'")

    def at(self, frame: int) -> "Stage":
        """Another frame; clips go round."""
        return replace(self, frame=frame % len(self.motion))

    def playing(self, motion: Motion) -> "Stage":
        """Another clip, from its start."""
        return replace(self, motion=motion, frame=0)

    def turned(self, joint: str, degrees: Degrees) -> "Stage":
        """Another turn of one joint."""
        return replace(self, joint_turns={**self.joint_turns, joint: degrees})

    def shaped(self, index: int, coefficient: float) -> "Stage":
        """Another value of one shape coefficient."""
        shape = (*self.body_shape[:index], coefficient, *self.body_shape[index + 1 :])
        return replace(self, body_shape=shape)

    def body_pose(self) -> BodyPose:
        """Theta of the frame with the turns on top, [1, 81] [rad]."""
        clip_pose = self.motion.body_pose[self.frame][None]
        body_pose, rotations = clip_pose.clone(), joint_matrices(clip_pose)
        for joint, degrees in self.joint_turns.items():
            if degrees != NO_TURN:
                index = self.body.joint_names.index(joint)
                turn = matrix_from_axis_angle(torch.tensor(degrees, dtype=rotations.dtype) * (math.pi / 180))
                rotations[:, index] = turn @ rotations[:, index]
                body_pose[:, 3 * index : 3 * index + 3] = pose_from_matrices(rotations)[:, 3 * index : 3 * index + 3]
        return body_pose

    def drape(self) -> "Drape":
        """The hair at rest on this stage. Takes as long as the draper takes."""
        pose = Motion(self.body_pose(), self.motion.fps, self.motion.name)
        with network_clock(self.draper) as network_times:
            sequence = drape_motion(self.draper, self.groom, self.body, pose, torch.tensor(self.body_shape))
        sequence.meta["frame"] = self.frame
        return Drape(self, sequence, sum(network_times) if network_times else None)


@dataclass(frozen=True, eq=False)
class Drape:
    """What came of a stage.

    Attributes:
        sequence: one frame, as files and measurements take it.
        network_milliseconds: wall time of the network alone, None for drapers without one.
    """

    stage: Stage
    sequence: DrapeSequence
    network_milliseconds: float | None

    @property
    def strands(self) -> Float[np.ndarray, "s n 3"]:
        """Draped guides [m, world]."""
        return self.sequence.strands[0]

    @property
    def body_vertices(self) -> Float[np.ndarray, "v 3"]:
        """The body under them [m, world]."""
        return self.sequence.body_vertices[0]

    @property
    def milliseconds(self) -> float:
        """Wall time from pose in to strands out."""
        return float(self.sequence.meta["milliseconds"])

    def figures(self) -> tuple[dict[str, float], dict[str, float]]:
        """Figures of merit by name, of the drape and of the groom as it was merely posed."""
        draped, posed = measure(self.sequence, self.stage.groom, self.stage.body)
        return _of_one_frame(draped), _of_one_frame(posed)

    def inside(self, strands: Float[np.ndarray, "m n 3"]) -> Bool[np.ndarray, "m n"]:
        """Which vertices of these strands are inside the body; roots, which lie on the skin, are not."""
        surface = bodies_of(self.sequence, self.stage.body).surface
        points = torch.from_numpy(strands[:, 1:].reshape(1, -1, 3))
        below = (signed_distance(points, surface) < 0).numpy().reshape(len(strands), -1)
        return np.pad(below, ((0, 0), (1, 0)))


def _of_one_frame(figures: Mapping[str, torch.Tensor]) -> dict[str, float]:
    return {name: float(figure[0]) for name, figure in figures.items()}


@contextmanager
def network_clock(draper: Draper) -> Iterator[list[float]]:
    """Collect the wall time of the draper's network [ms]; none where it has no network."""
    times: list[float] = []
    if not isinstance(draper, NeuralDraper):
        yield times
        return
    before = draper.backend().network_seconds
    yield times
    times.append(1000 * (draper.backend().network_seconds - before))
