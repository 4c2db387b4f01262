"""A motion: one body pose per frame, and where the body is in the world.

Rotations between frames are interpolated spherically, joint by joint; translations linearly.
"""

import re
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from quaffure.body.pose_limits import Rows, check_body_pose, tensor_of
from quaffure.body.surface_morphs import SurfaceMorphs
from quaffure.errors import InputError
from quaffure.geometry.rotation import axis_angle_from_matrix, interpolate_rotations, matrix_from_axis_angle

# A joint that rotates faster than this [rad/s] and returns within FLIP_SECONDS is an artefact: swapped markers, or an
# Euler angle that flipped. Strikes and kicks reach 30 rad/s; a quick shake of the head, over three joints, 4 each.
LIMB_FLIP_SPEED = 35.0
AXIAL_FLIP_SPEED = 8.0
AXIAL_JOINTS = (0, 6, 7, 8, 14, 15, 16)  # Hips, LowerBack, Spine, Spine1, Neck, Neck1, Head
FLIP_SECONDS = 0.1
# A joint has returned when at most this share of its largest deviation is left.
FLIP_RETURN_SHARE = 0.3
# 55 minutes at 30 fps; a frame takes up to 10 KB while joint flips are repaired.
MAX_FRAMES = 100_000
LARGEST_TRANSLATION = 1000.0  # m; farther away, vertices in float32 would be 0.1 mm apart

_FRAMES = re.compile(r"(\d{0,9}):(\d{0,9})(?::(\d{1,9}))?|(?P<one>\d{1,9})")


@dataclass(frozen=True, init=False)
class Motion:
    """Body poses at a constant rate.

    Attributes:
        body_pose: [F,81] axis-angle of each joint [rad], relative to its parent, in rest frames aligned with the world.
        fps: frames per second.
        name: for messages and files.
        translation: [F,3] of the body from its rest position [m, world]; None where it stays in place. The heading is
            part of `body_pose`: the rotation of Hips, joint 0.
        notes: what its reader guessed, in words.
        start: time of the first frame in its file [s].
        morphs: of the surface of the body that the motion was read for; None where it does not change.

    Poses and translations may be arrays or lists, which become tensors; tensors are kept as they are.

    Raises:
        InputError: no frames, another width than three numbers a joint, a value or a rate that is not finite, a
            rotation beyond 4 pi, or translations of another number of frames or beyond a kilometre.
    """

    body_pose: Float[Tensor, "..."]  # any shape for the type checker, because files hold any shape: checked below
    fps: float
    name: str
    translation: Float[Tensor, "..."] | None = None
    notes: tuple[str, ...] = ()
    start: float = 0.0
    morphs: SurfaceMorphs | None = None

    def __init__(
        self,
        body_pose: Rows,
        fps: float,
        name: str,
        translation: Rows | None = None,
        notes: tuple[str, ...] = (),
        start: float = 0.0,
        morphs: SurfaceMorphs | None = None,
    ) -> None:
        pose = tensor_of(body_pose, name)
        path = None if translation is None else tensor_of(translation, f"translation of {name}")
        vars(self).update(body_pose=pose, translation=path, fps=fps, name=name, notes=notes, start=start, morphs=morphs)
        self._check()

    def _check(self) -> None:
        if self.body_pose.ndim != 2 or self.body_pose.shape[0] < 1 or self.body_pose.shape[1] != 81:
            raise InputError(self.name, "body poses [frames >= 1, 81]", f"{list(self.body_pose.shape)}")
        check_body_pose(self.body_pose, self.name)
        if not 0.0 < self.fps < float("inf"):
            raise InputError(self.name, "a frame rate above 0 fps", f"{self.fps}")
        self._check_translation()
        if self.morphs is not None and len(self.morphs) != len(self):
            raise InputError(self.name, f"weights of morph targets in {len(self)} frames", f"{len(self.morphs)}")

    def _check_translation(self) -> None:
        if self.translation is None:
            return
        if self.translation.shape != (len(self), 3):
            raise InputError(self.name, f"translations [{len(self)}, 3]", f"{list(self.translation.shape)}")
        farthest = float(self.translation.abs().max())
        if not farthest <= LARGEST_TRANSLATION:
            raise InputError(self.name, f"translations within {LARGEST_TRANSLATION:g} m", f"{farthest:.3g} m")

    def __len__(self) -> int:
        return len(self.body_pose)

    @property
    def seconds(self) -> float:
        """Time from the first frame to the last [s]."""
        return (len(self) - 1) / self.fps

    @property
    def times(self) -> Float[np.ndarray, " f"]:
        """Times of the frames in the file that they come from [s]."""
        return self.start + np.arange(len(self)) / self.fps

    def in_place(self) -> "Motion":
        """The motion without translation; heading and tilt stay."""
        return replace(self, translation=None)

    def select(self, frames: slice) -> "Motion":
        """Some of the frames, at the same rate."""
        translation = None if self.translation is None else self.translation[frames]
        start = self.start + frames.indices(len(self))[0] / self.fps
        morphs = None if self.morphs is None else self.morphs.select(frames)
        return replace(self, body_pose=self.body_pose[frames], translation=translation, start=start, morphs=morphs)

    def frames(self, spec: str | int) -> "Motion":
        """The frames `A:B:STEP`: from A up to but without B, every STEP-th, each of which may be left out; or `A`.

        Raises:
            InputError: `spec` reads otherwise, STEP is 0, or the range is empty or leaves the motion.
        """
        spec = str(spec).strip()
        match = _FRAMES.fullmatch(spec)
        if match is None:
            expected = "A:B:STEP with whole numbers, such as 300:600:2"
            raise InputError(f"frames '{spec[:40]}'", expected, f"'{spec[:40]}'")
        first = int(match["one"] or match[1] or 0)
        end = first + 1 if match["one"] else int(match[2]) if match[2] else len(self)
        step = int(match[3] or 1)
        if match["one"] and first >= len(self):
            raise InputError(f"frames '{spec}'", f"0 to {len(self) - 1}, the frames of {self.name}", str(first))
        if step < 1 or not first < end <= len(self):
            expected = f"0 <= A < B <= {len(self)} (the frames of {self.name}) and STEP >= 1"
            raise InputError(f"frames '{spec}'", expected, f"A = {first}, B = {end}, STEP = {step}")
        return replace(self.select(slice(first, end, step)), fps=self.fps / step)


def joint_matrices(body_pose: Float[Tensor, "f 81"]) -> Float[Tensor, "f 27 3 3"]:
    """Rotation of each joint relative to its parent, in float64."""
    return matrix_from_axis_angle(body_pose.double().unflatten(-1, (27, 3)))


def pose_from_matrices(rotations: Float[Tensor, "f *batch 27 3 3"]) -> Float[Tensor, "f *batch 81"]:
    """Axis-angles [rad] of joint rotations, each continuous from frame to frame (the first axis).

    Two vectors of length up to 2 pi represent the same rotation; each frame takes the one nearer to the previous
    frame, so that a joint that passes pi does not jump to the opposite vector.
    """
    short = axis_angle_from_matrix(rotations)
    angle = short.norm(dim=-1, keepdim=True)
    # Below 1e-6 rad the axis is rounding, and 2 pi minus it would be arbitrary.
    long = torch.where(angle > 1e-6, short * (1 - 2 * torch.pi / angle.clamp(min=1e-6)), short)
    leaves = (long[1:] - short[:-1]).norm(dim=-1) < (short[1:] - short[:-1]).norm(dim=-1)
    # Few joints pass pi; only these need the sequential loop over the frames.
    passing = leaves.any(dim=0)
    short[:, passing] = _continuous(short[:, passing], long[:, passing])
    return short.flatten(-2).float()


def _continuous(short: Float[Tensor, "f n 3"], long: Float[Tensor, "f n 3"]) -> Float[Tensor, "f n 3"]:
    """Frame by frame, `short` or `long`: whichever is nearer to the previous choice."""
    chosen = [short[0]]
    for frame in range(1, len(short)):
        before = chosen[-1]
        nearer = (long[frame] - before).norm(dim=-1) < (short[frame] - before).norm(dim=-1)
        chosen.append(torch.where(nearer[:, None], long[frame], short[frame]))
    return torch.stack(chosen)


def resample(motion: Motion, fps: float) -> Motion:
    """The motion at another frame rate, from its first frame to the last that the new rate hits.

    Raises:
        InputError: `fps` is not above 0, or the result would have more than `MAX_FRAMES` frames.
    """
    if not 0.0 < fps < float("inf"):
        raise InputError(motion.name, "a frame rate above 0 fps", f"{fps}")
    if fps == motion.fps or len(motion) == 1:
        return replace(motion, fps=fps)
    # The small share of a frame keeps a last frame that only rounding puts beyond the end (120 fps as 0.00833333 s).
    intervals = motion.seconds * fps + 1e-3
    if not intervals < MAX_FRAMES:
        raise InputError(motion.name, f"at most {MAX_FRAMES} frames at {fps:g} fps", f"{intervals:.0f}")
    position = (torch.arange(int(intervals) + 1, dtype=torch.float64) * (motion.fps / fps)).clamp(max=len(motion) - 1)
    before = position.long().clamp(max=len(motion) - 2)
    rotations = joint_matrices(motion.body_pose)
    share = (position - before)[:, None].expand(-1, 27)
    between = interpolate_rotations(rotations[before], rotations[before + 1], share)
    translation = motion.translation
    if translation is not None:
        weight = (position - before)[:, None].to(translation)
        translation = torch.lerp(translation[before], translation[before + 1], weight)
    morphs = None if motion.morphs is None else motion.morphs.between(position)
    return Motion(pose_from_matrices(between), fps, motion.name, translation, motion.notes, motion.start, morphs)


def filter_flips(motion: Motion) -> Motion:
    """The motion with joint flips repaired: short runs of frames to which a joint jumps and from which it returns.

    A run starts or ends where a joint rotates faster than `LIMB_FLIP_SPEED` or `AXIAL_FLIP_SPEED`, and within
    `FLIP_SECONDS` the joint returns. Its frames are interpolated between the valid ones on both sides. A jump without
    return is kept, as is every joint without a jump. Axis-angles come out continuous
    (see `pose_from_matrices`).
    """
    limit = torch.full((27,), LIMB_FLIP_SPEED / motion.fps, dtype=torch.float64)
    limit[list(AXIAL_JOINTS)] = AXIAL_FLIP_SPEED / motion.fps
    longest_run = max(1, min(round(FLIP_SECONDS * motion.fps), len(motion)))
    rotations = joint_matrices(motion.body_pose)
    # Forwards, then backwards: a run may start slowly and end with the jump.
    for _ in range(2):
        jumps = _angle_between(rotations[:-1], rotations[1:]) > limit
        for frame, joint in jumps.nonzero().tolist():
            _repair_run(rotations[:, joint], frame, longest_run, float(limit[joint]))
        rotations = rotations.flip(0)
    return replace(motion, body_pose=pose_from_matrices(rotations))


def without_heading(body_pose: Float[Tensor, "f 81"]) -> Float[Tensor, "f 81"]:
    """Body poses whose Hips (joint 0) keep their tilt and lose their rotation about the vertical.

    It is the twist of the swing-twist decomposition about world z; gravity, contact and hence hair are invariant to it.
    """
    rotations = joint_matrices(body_pose)
    hips = rotations[:, 0]
    heading = torch.atan2(hips[:, 1, 0] - hips[:, 0, 1], hips[:, 0, 0] + hips[:, 1, 1])
    vertical = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64, device=body_pose.device)
    turn_back = matrix_from_axis_angle(-heading[:, None] * vertical)
    hips_pose = axis_angle_from_matrix(turn_back @ hips).to(body_pose)
    return torch.cat([hips_pose, body_pose[:, 3:]], dim=-1)


def _angle_between(a: Float[Tensor, "*#n 3 3"], b: Float[Tensor, "*#n 3 3"]) -> Float[Tensor, "*n"]:
    return axis_angle_from_matrix(a.transpose(-1, -2) @ b).norm(dim=-1)


def _repair_run(rotations: Float[Tensor, "f 3 3"], before: int, longest_run: int, limit: float) -> None:
    """Overwrite, in one joint's `rotations`, the run that starts after frame `before`, if it is a flip."""
    after = rotations[before + 1 : before + longest_run + 2]
    distance = _angle_between(rotations[before], after)
    if distance[0] <= limit:
        return  # already repaired as part of an earlier run
    returned = distance[1:] <= FLIP_RETURN_SHARE * distance.cummax(0).values[:-1]
    if not bool(returned.any()):
        return
    length = int(returned.int().argmax()) + 1
    share = torch.arange(1, length + 1, dtype=rotations.dtype) / (length + 1)
    valid_before, valid_after = rotations[before].clone(), rotations[before + length + 1].clone()
    rotations[before + 1 : before + length + 1] = interpolate_rotations(valid_before, valid_after, share)
