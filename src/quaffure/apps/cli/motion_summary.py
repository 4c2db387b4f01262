"""What there is to know of a motion and of the skeleton that it comes with."""

from pathlib import Path
from typing import Any

import numpy as np
import torch

from quaffure.body.body_model import BodyModel
from quaffure.body.bvh_clip import BvhClip
from quaffure.body.calibration_pose import calibration_pose
from quaffure.body.joint_map import JointMap
from quaffure.body.motion import Motion, resample
from quaffure.errors import InputError
from quaffure.io.load_motion import FPS
from quaffure.io.read_motion import read_motion

REFUSED = "refused"
"""Key of the reason for which a file that can be read cannot be used; without it, it can."""

Summary = dict[str, Any]


def joint_map_summary(clip: BvhClip, joint_map: JointMap) -> Summary:
    """Which joints of a skeleton are used, and for what."""
    used = {name for source in joint_map.values() for name in source.joints}
    return {
        "joint_map": {joint: list(source.joints) for joint, source in joint_map.items()},
        "joints_without_use": sorted({*clip.joint_names} - used),
    }


def usable_motion(path: Path, body: BodyModel, joints: Path | None = None) -> Summary:
    """The motion in a file on the body's joints, or why there is none.

    Args:
        joints: a joint map.
    """
    try:
        motion = read_motion(path, body, joints)
    except InputError as error:
        return {REFUSED: f"expected {error.expected}, found {error.found}"}
    return motion_summary(motion, body)


def motion_summary(motion: Motion, body: BodyModel) -> Summary:
    """A motion on the body's joints, at the rate at which it is draped."""
    file = {} if motion.fps == FPS else {"frames_of_the_file": len(motion), "fps_of_the_file": round(motion.fps, 3)}
    motion = resample(motion, FPS)
    first = calibration_pose(motion, body)
    return {
        **file,
        "frames": len(motion),
        "fps": round(motion.fps, 3),
        "seconds": round(motion.seconds, 2),
        "travels_m": None if motion.translation is None else extent(motion.translation.numpy()),
        "head_above_hips_m": _head_height(motion, body),
        "notes": [*motion.notes, *([] if first is None else [str(first)])],
    }


def extent(points: np.ndarray) -> list[list[float]]:
    """Smallest and largest coordinates."""
    return [[float(f"{value:.4g}") for value in corner] for corner in (points.min(axis=0), points.max(axis=0))]


def _head_height(motion: Motion, body: BodyModel) -> float:
    """Mean height of the head above the hips [m]: about 0.7 of someone upright."""
    some = motion.select(slice(None, None, max(1, len(motion) // 50))).body_pose
    _, joints = body.posed_joints(some, torch.zeros(len(some), 10))
    head, hips = (body.joint_names.index(name) for name in ("Head", "Hips"))
    return round(float((joints[:, head] - joints[:, hips])[:, 2].mean()), 2)
