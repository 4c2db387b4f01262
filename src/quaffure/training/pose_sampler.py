"""Fresh bodies for every training step: short runs of consecutive frames, each on a body of its own shape."""

from dataclasses import dataclass

import torch

from quaffure.body.motion import Motion
from quaffure.body.pose_prior import PosePrior
from quaffure.types import BodyPose, BodyShape, Float, Tensor

FPS = 30.0
LARGEST_COEFFICIENT = 2.5  # standard deviations of body shape


@dataclass(frozen=True)
class PoseSampler:
    """Draws from the pose prior, and from motion clips where there are any.

    Attributes:
        prior: fitted to the training clips.
        clips: motions at 30 fps; may be empty.
        clip_share: how many of the runs come from the clips when there are any.
        calm_share: how many of the runs are brought closer to the rest pose, by a share drawn anew.
    """

    prior: PosePrior
    clips: tuple[Motion, ...] = ()
    clip_share: float = 0.5
    calm_share: float = 0.3

    def sample(self, runs: int, frames: int, generator: torch.Generator) -> tuple[BodyPose, BodyShape]:
        """Poses [runs * frames, 81], run after run, and shapes, the same along a run."""
        poses = self.prior.sample_sequences(runs, frames, FPS, generator)
        for run in range(runs):
            if self.clips and torch.rand((), generator=generator) < self.clip_share:
                poses[run] = self._from_clip(frames, generator)
            if torch.rand((), generator=generator) < self.calm_share:
                poses[run] *= torch.rand((), generator=generator)
        shapes = torch.randn(runs, 1, 10, generator=generator).clamp(-LARGEST_COEFFICIENT, LARGEST_COEFFICIENT)
        return poses.flatten(0, 1), shapes.expand(-1, frames, -1).flatten(0, 1)

    def _from_clip(self, frames: int, generator: torch.Generator) -> Float[Tensor, "f 81"]:
        lengths = torch.tensor([len(clip) - frames + 1 for clip in self.clips], dtype=torch.float32)
        # The square root keeps a long clip from drowning the short ones.
        clip = self.clips[int(torch.multinomial(lengths.sqrt(), 1, generator=generator))]
        start = int(torch.randint(len(clip) - frames + 1, (), generator=generator))
        return clip.body_pose[start : start + frames]
