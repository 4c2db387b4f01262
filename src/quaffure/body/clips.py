"""Hand-made motion clips that come with the package: loops of two to four seconds at 30 fps.

Each is a table of key angles, evenly spaced over the loop and joined by a periodic cubic spline, so that every loop
closes with matching speed. Angles are rotation vectors in degrees about the axes of the rest pose (z up, facing -y):
x positive bends forward, y positive leans to the body's left, z positive turns to the left.
"""

from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from torch import Tensor

from quaffure.body.body_model import BodyModel
from quaffure.body.motion import Motion, pose_from_matrices
from quaffure.body.neck import NECK_SHARES
from quaffure.body.retargeting import align_bone, body_bone
from quaffure.errors import InputError
from quaffure.geometry.rotation import matrix_from_axis_angle

CLIP_FPS = 30.0
# Upper arms of someone standing at ease, away from the vertical; closer, they would sink into heavier bodies.
HANGING_ARM_DEGREES = 15.0
RELAXED_ELBOW_DEGREES = 15.0

Angles = tuple[tuple[float, float, float], ...]


@dataclass(frozen=True)
class KeyedClip:
    """Key angles of one loop.

    Attributes:
        seconds: length of the loop [s].
        angles: rotation vectors by joint [degrees], on top of arms that hang.
        elbow_bend: forward bend of an elbow from the straight arm [degrees], by forearm.
    """

    seconds: float
    angles: dict[str, Angles]
    elbow_bend: dict[str, tuple[float, ...]] = field(default_factory=dict)


def bundled_clip(name: str, body: BodyModel) -> Motion:
    """One of `CLIP_NAMES` as a motion at 30 fps; the frame after the last is the first again.

    Raises:
        InputError: no clip of that name.
    """
    if name not in _CLIPS:
        raise InputError(f"motion '{name}'", f"one of {', '.join(CLIP_NAMES)}", f"'{name}'")
    clip = _CLIPS[name]
    frames = round(clip.seconds * CLIP_FPS)
    rotations = [_joint_rotations(clip, joint, frames, body) for joint in body.joint_names]
    return Motion(pose_from_matrices(torch.stack(rotations, dim=1)), CLIP_FPS, name)


def _joint_rotations(clip: KeyedClip, joint: str, frames: int, body: BodyModel) -> Float[Tensor, "f 3 3"]:
    if joint in ("LeftForeArm", "RightForeArm"):
        bend = _looped(np.array(clip.elbow_bend.get(joint, (RELAXED_ELBOW_DEGREES,)))[:, None], frames)
        return matrix_from_axis_angle(bend * _elbow_axis(body, joint)) @ _straight_elbow(body, joint)
    turned = matrix_from_axis_angle(_looped(np.array(clip.angles.get(joint, ((0.0, 0.0, 0.0),))), frames))
    return turned @ _hanging_arm(body, joint) if joint in ("LeftArm", "RightArm") else turned


def _looped(keys: Float[np.ndarray, "k a"], frames: int) -> Float[Tensor, "f a"]:
    """Keys [degrees] over one loop, in radians."""
    if len(keys) == 1:
        return torch.from_numpy(np.radians(keys).repeat(frames, axis=0))
    closed = np.concatenate([keys, keys[:1]])
    spline = CubicSpline(np.linspace(0.0, 1.0, len(closed)), closed, bc_type="periodic")
    return torch.from_numpy(np.radians(spline(np.arange(frames) / frames)))


def _hanging_arm(body: BodyModel, joint: str) -> Float[Tensor, "3 3"]:
    """Rotation of an upper arm from the A pose of the rest body to hanging at its side."""
    side = np.radians(HANGING_ARM_DEGREES)
    outward = 1.0 if joint.startswith("Left") else -1.0
    hanging = torch.tensor([outward * np.sin(side), 0.0, -np.cos(side)])
    return align_bone(body_bone(body, joint, joint.replace("Arm", "ForeArm")), hanging)


def _straight_elbow(body: BodyModel, joint: str) -> Float[Tensor, "3 3"]:
    """Rotation of a forearm from the rest body's bent elbow to the line of its upper arm."""
    hand, arm = joint.replace("ForeArm", "Hand"), joint.replace("ForeArm", "Arm")
    return align_bone(body_bone(body, joint, hand), body_bone(body, arm, joint))


def _elbow_axis(body: BodyModel, joint: str) -> Float[Tensor, "3"]:
    """Axis in the rest frame about which a positive angle brings the hand of a straight arm forward."""
    upper_arm = body_bone(body, joint.replace("ForeArm", "Arm"), joint).double()
    forward = torch.tensor([0.0, -1.0, 0.0], dtype=torch.float64)
    return torch.nn.functional.normalize(torch.linalg.cross(upper_arm, forward), dim=-1)


def _spread(angles: Angles, shares: dict[str, float]) -> dict[str, Angles]:
    """One turn of a whole chain of joints, each taking its share."""
    return {joint: tuple((share * x, share * y, share * z) for x, y, z in angles) for joint, share in shares.items()}


def _both_sides(joint: str, left: Angles, half_loop_later: bool = False) -> dict[str, Angles]:
    """The left joint's angles and their mirror image for the right one."""
    shift = len(left) // 2 if half_loop_later else 0
    shifted = left[shift:] + left[:shift]
    return {f"Left{joint}": left, f"Right{joint}": tuple((x, -y, -z) for x, y, z in shifted)}


def _pitch(degrees: Float[np.ndarray, " k"]) -> Angles:
    return tuple((float(angle), 0.0, 0.0) for angle in degrees)


_SPINE = {"LowerBack": 0.4, "Spine": 0.35, "Spine1": 0.25}


def _neck_turn() -> KeyedClip:
    """From looking right to looking left and back, as in Fig. 6 of the paper."""
    turn = tuple((0.0, 0.0, -70.0 * float(np.cos(2 * np.pi * key / 8))) for key in range(8))
    return KeyedClip(4.0, _spread(turn, NECK_SHARES))


def _nod() -> KeyedClip:
    """Two nods, the second one smaller, each with a look up before it."""
    return KeyedClip(3.0, _spread(_pitch(np.array([-10.0, 15, 38, 15, -18, -2, 24, 5])), NECK_SHARES))


def _bow() -> KeyedClip:
    """A bow from the hips, held for a moment, arms hanging down from the shoulders all the while."""
    depth = np.array([0.0, 0.05, 0.45, 0.92, 1.0, 0.95, 0.5, 0.08])
    hips, spine, neck = 35.0 * depth, 40.0 * depth, 20.0 * depth
    return KeyedClip(
        4.0,
        {
            "Hips": _pitch(hips),
            **_both_sides("UpLeg", _pitch(-hips)),
            **_spread(_pitch(spine), _SPINE),
            **_spread(_pitch(neck), NECK_SHARES),
            **_both_sides("Arm", _pitch(-0.85 * (hips + spine))),
        },
    )


def _shrug() -> KeyedClip:
    """Both shoulders up to the ears and down again, head a little to one side, hands turning out."""
    lift = np.array([0.0, 0.1, 0.7, 1.0, 0.95, 0.5, 0.1, 0.0])
    elbow = tuple(15.0 + 45.0 * lift)
    return KeyedClip(
        2.4,
        {
            **_both_sides("Shoulder", tuple((0.0, -20.0 * up, 0.0) for up in lift)),
            **_both_sides("Arm", tuple((0.0, 12.0 * up, 30.0 * up) for up in lift)),
            **_spread(tuple((4.0 * up, 12.0 * up, 0.0) for up in lift), NECK_SHARES),
        },
        {"LeftForeArm": elbow, "RightForeArm": elbow},
    )


def _walk() -> KeyedClip:
    """Two steps on the spot, left heel down first. Leg angles at eighths of the cycle follow, roughly, the
    textbook curves of level walking (Winter, Biomechanics and Motor Control of Human Movement)."""
    hip = np.array([30.0, 25, 12, -1, -10, -3, 18, 30])
    knee = np.array([5.0, 17, 12, 6, 10, 40, 58, 28])
    ankle = np.array([0.0, -3, 5, 10, 8, -15, -5, 0])
    wave = np.cos(2 * np.pi * np.arange(8) / 8)
    yaw = tuple((0.0, 0.0, float(angle)) for angle in wave)
    elbow = 22.0 - 8.0 * wave
    return KeyedClip(
        2.0,
        {
            "Hips": tuple((2.0, 0.0, -5.0 * z) for _, _, z in yaw),
            **_spread(tuple((2.0, 0.0, 10.0 * z) for _, _, z in yaw), _SPINE),
            **_spread(tuple((-2.0, 0.0, -5.0 * z) for _, _, z in yaw), NECK_SHARES),
            **_both_sides("UpLeg", tuple((-float(angle), 4.0, 0.0) for angle in hip), half_loop_later=True),
            **_both_sides("Leg", _pitch(knee), half_loop_later=True),
            **_both_sides("Foot", _pitch(-ankle), half_loop_later=True),
            **_both_sides("Arm", _pitch(20.0 * wave), half_loop_later=True),
        },
        {"LeftForeArm": tuple(elbow), "RightForeArm": tuple(np.roll(elbow, 4))},
    )


_CLIPS = {"neck_turn": _neck_turn(), "nod": _nod(), "bow": _bow(), "shrug": _shrug(), "walk": _walk()}
CLIP_NAMES: tuple[str, ...] = tuple(_CLIPS)
