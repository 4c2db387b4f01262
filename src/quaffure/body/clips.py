"""Motion clips that come with the package (`assets/clips.toml`): loops of two to four seconds at 30 fps.

Each joint has key angles, evenly spaced over the loop and joined by a periodic cubic spline, so that every loop closes
with matching speed. Angles are rotation vectors in degrees about the axes of the rest pose (z up, facing -y).
"""

import tomllib
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib.resources import files
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from quaffure.body.body_model import BodyModel
from quaffure.body.motion import Motion, pose_from_matrices
from quaffure.body.neck import NECK_SHARES
from quaffure.body.retargeting import align_bone, body_bone
from quaffure.errors import InputError
from quaffure.geometry.rotation import matrix_from_axis_angle

CLIP_NAMES = ("neck_turn", "nod", "bow", "shrug", "walk", "idle")
CLIP_FPS = 30.0
# Upper arms of someone standing at ease, away from the vertical; closer, they would penetrate heavier bodies.
HANGING_ARM_DEGREES = 15.0
RELAXED_ELBOW_DEGREES = 15.0
# What each joint takes of a rotation of its chain.
CHAINS = {"neck_chain": NECK_SHARES, "spine_chain": {"LowerBack": 0.4, "Spine": 0.35, "Spine1": 0.25}}

Keys = Float[np.ndarray, "k 3"]


@dataclass(frozen=True)
class KeyedClip:
    """Key angles of one loop.

    Attributes:
        seconds: length of the loop [s].
        angles: rotation vectors by joint [degrees], relative to hanging arms; of a forearm only the first component,
            its forward bend from the straight arm.
    """

    seconds: float
    angles: dict[str, Keys]


def bundled_clip(name: str, body: BodyModel) -> Motion:
    """One of `CLIP_NAMES` as a motion at 30 fps; the frame after the last is the first again.

    Raises:
        InputError: no clip of that name.
    """
    if name not in CLIP_NAMES:
        raise InputError(f"motion '{name}'", f"one of {', '.join(CLIP_NAMES)}", f"'{name}'")
    return Motion(_body_pose(name, body).clone(), CLIP_FPS, name)


@lru_cache(maxsize=2 * len(CLIP_NAMES))
def _body_pose(name: str, body: BodyModel) -> Float[Tensor, "f 81"]:
    clip = _read_clip(name, tuple(body.joint_names))
    frames = round(clip.seconds * CLIP_FPS)
    rotations = [_joint_rotations(clip, joint, frames, body) for joint in body.joint_names]
    return pose_from_matrices(torch.stack(rotations, dim=1))


@cache
def _read_clip(name: str, joint_names: tuple[str, ...]) -> KeyedClip:
    table = tomllib.loads((files("quaffure") / "assets" / "clips.toml").read_text(encoding="utf-8"))[name]
    angles: dict[str, Keys] = {}
    for joint, motion in table["joints"].items():
        keys = _keys(motion, table.get("curves", {}))
        if joint in CHAINS:
            angles |= {link: share * keys for link, share in CHAINS[joint].items()}
        elif joint in joint_names:
            angles[joint] = keys
        else:
            angles[f"Left{joint}"] = keys
            shift = len(keys) // 2 if table.get("alternating") else 0
            angles[f"Right{joint}"] = np.roll(keys, shift, axis=0) * [1, -1, -1]
    return KeyedClip(table["seconds"], angles)


def _keys(motion: dict[str, Any], curves: dict[str, list[int | float]]) -> Keys:
    """Rotation vectors of one joint [degrees]: constant + curve * amplitude, or as they are."""
    if "keys" in motion:
        return np.array(motion["keys"], dtype=float)
    constant = np.array(motion.get("constant", (0.0, 0.0, 0.0)), dtype=float)
    return constant + np.outer(curves[motion["curve"]], motion["amplitude"])


def _joint_rotations(clip: KeyedClip, joint: str, frames: int, body: BodyModel) -> Float[Tensor, "f 3 3"]:
    if joint in ("LeftForeArm", "RightForeArm"):
        bend = _looped(clip.angles.get(joint, np.array([[RELAXED_ELBOW_DEGREES, 0.0, 0.0]])), frames)[:, :1]
        return matrix_from_axis_angle(bend * _elbow_axis(body, joint)) @ _straight_elbow(body, joint)
    rotations = matrix_from_axis_angle(_looped(clip.angles.get(joint, np.zeros((1, 3))), frames))
    return rotations @ _hanging_arm(body, joint) if joint in ("LeftArm", "RightArm") else rotations


def _looped(keys: Keys, frames: int) -> Float[Tensor, "f 3"]:
    """Keys [degrees] over one loop, in radians."""
    from scipy.interpolate import CubicSpline  # takes a fifth of the time of `import quaffure.apps.cli.main`

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
