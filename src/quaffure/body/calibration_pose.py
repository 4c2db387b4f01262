"""The calibration pose that capture files often begin with: the figure stands straight, then jumps into the motion."""

from dataclasses import dataclass

import torch

from quaffure.body.body_model import BodyModel
from quaffure.body.motion import Motion, joint_matrices
from quaffure.geometry.rotation import axis_angle_from_matrix
from quaffure.types import Float, Tensor

SEARCHED_SECONDS = 1.0
"""The pose is held for less."""
LEAST_JUMP = 0.5
"""Rotation of a joint from one frame to the next, 1/30 s later, above which the motion is cut [rad]."""
MOST_STILL = 0.05
"""Rotation of any joint from frame to frame while the pose is held [rad]."""
STRAIGHT, UPRIGHT, LEVEL = (torch.pi / 180 * angle for angle in (30.0, 20.0, 25.0))
"""Largest bend of an elbow or a knee, angle of the trunk to the vertical, and rise of the arms in a T pose [rad]."""
AT_REST = 0.1
"""Largest rotation of any joint but the hips in the rest pose of the body, whose elbows are bent [rad]."""
LIMBS = (("Arm", "ForeArm", "Hand"), ("UpLeg", "Leg", "Foot"))


@dataclass(frozen=True)
class CalibrationPose:
    """What a motion begins with.

    Attributes:
        frames: number of frames in which the pose is held.
        is_t_pose: whether the arms are stretched out to the sides.
        is_rest: whether it is the rest pose of the body.
        jump: largest rotation of a joint to the frame after them [rad].
    """

    frames: int
    is_t_pose: bool
    is_rest: bool
    jump: float

    def __str__(self) -> str:
        held, stand = (
            ("the first frame", "stands") if self.frames == 1 else (f"the first {self.frames} frames", "stand")
        )
        straight = "a T pose" if self.is_t_pose else "a pose with straight arms and legs"
        pose = "the rest pose of the body" if self.is_rest else straight
        degrees = round(180 / torch.pi * self.jump)
        return (
            f"{held} {stand} in {pose}, {degrees} degrees from the next frame, as for a calibration; "
            f"leave {'it' if self.frames == 1 else 'them'} out with --frames '{self.frames}:'"
        )


def calibration_pose(motion: Motion, body: BodyModel) -> CalibrationPose | None:
    """The pose that a motion of 30 frames a second is held in at first, and cut from within a frame or two; None where
    it begins otherwise."""
    step = _steps(motion.body_pose[: 2 + round(SEARCHED_SECONDS * motion.fps)])
    cuts = (step > LEAST_JUMP).nonzero()
    if not len(cuts):
        return None
    first = int(cuts[0])
    # Resampling to another rate may put one frame between the two sides of a cut.
    last = first + int((step[first + 1 : first + 2] > LEAST_JUMP / 2).any())
    is_cut = not (step[:first] > MOST_STILL).any() and not (step[last + 1 : last + 2] > LEAST_JUMP / 2).any()
    if not is_cut or last + 2 > len(motion):
        return None
    bend, lean, rise = _stance(motion.body_pose[:1], body)
    is_rest = bool(motion.body_pose[0].view(-1, 3)[1:].norm(dim=-1).max() < AT_REST)
    if lean > UPRIGHT or not (bend < STRAIGHT or is_rest):
        return None
    return CalibrationPose(last + 1, rise < LEVEL, is_rest, float(step[first : last + 1].sum()))


def _steps(body_pose: Float[Tensor, "f 81"]) -> Float[Tensor, " g"]:
    """Largest rotation of any joint, from each frame to the next [rad]."""
    rotations = joint_matrices(body_pose)
    between = axis_angle_from_matrix(rotations[:-1].transpose(-1, -2) @ rotations[1:])
    return between.norm(dim=-1).amax(dim=-1) if len(between) else torch.zeros(0, dtype=torch.float64)


def _stance(body_pose: Float[Tensor, "1 81"], body: BodyModel) -> tuple[float, float, float]:
    """Largest bend of an elbow or a knee, angle of the trunk to the vertical, and largest angle of an upper arm to the
    level [rad]."""
    _, joints = body.posed_joints(body_pose, torch.zeros(1, 10))
    place = dict(zip(body.joint_names, joints[0].double()))
    bends, rises = [], []
    for side in ("Left", "Right"):
        for start, middle, end in LIMBS:
            upper = place[f"{side}{middle}"] - place[f"{side}{start}"]
            lower = place[f"{side}{end}"] - place[f"{side}{middle}"]
            bends.append(_angle(upper, lower))
            if start == "Arm":
                rises.append(abs(torch.pi / 2 - _angle(upper, _up(upper))))
    trunk = place["Head"] - place["Hips"]
    return max(bends), _angle(trunk, _up(trunk)), max(rises)


def _up(vector: Float[Tensor, "3"]) -> Float[Tensor, "3"]:
    return vector.new_tensor([0.0, 0.0, 1.0])


def _angle(a: Float[Tensor, "3"], b: Float[Tensor, "3"]) -> float:
    return float(torch.arccos((a @ b / (a.norm() * b.norm())).clamp(-1, 1)))
