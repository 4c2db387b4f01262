"""A distribution of body poses and of short motions, fitted to motion capture: for training without motion clips.

A pose is 81 numbers v, three a joint: the rotation vector from the joint's mean rotation. Each has its own distribution
(a table of quantiles, so an elbow bends one way only and no number leaves the observed range); together they are a
Gaussian copula:

    z in R^K standard normal, one stationary process each      scores s = L z      v = quantile table(s)
    joint rotation = mean exp(v)

In time each z is a Matern process of order 3/2 (x'' + 2 r x' + r^2 x = white noise; stationary, once differentiable),
its rate r [1/s] fitted to the speed of that component in the clips.
"""

from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from quaffure.body.motion import pose_from_matrices
from quaffure.geometry.rotation import matrix_from_axis_angle

PRIOR_FILE = Path(str(files("quaffure") / "assets" / "pose_prior.npz"))


@dataclass(frozen=True)
class PosePrior:
    """Random poses and short motions with zero heading (hair does not depend on it).

    Attributes:
        mean_pose: mean rotation of each joint, as a body pose [rad].
        scores: evenly spaced standard scores of the quantile tables; scores beyond both ends are clamped.
        quantiles: rotation vectors from the mean [rad] at those scores.
        loadings: standard scores of the 81 numbers from the K components (L); its rows have unit length.
        rates: speed of each component [1/s].
    """

    mean_pose: Float[Tensor, "81"]
    scores: Float[Tensor, " q"]
    quantiles: Float[Tensor, "q 81"]
    loadings: Float[Tensor, "81 c"]
    rates: Float[Tensor, " c"]

    def sample(self, count: int, generator: torch.Generator) -> Float[Tensor, "count 81"]:
        """Independent body poses [rad]."""
        return self._pose(torch.randn(1, count, len(self.rates), generator=generator))[0]

    def sample_sequences(
        self, count: int, frames: int, fps: float, generator: torch.Generator
    ) -> Float[Tensor, "count frames 81"]:
        """Independent motions of consecutive frames [rad]; each frame by itself is distributed as in `sample`."""
        decay = torch.exp(-self.rates / fps)
        step = self.rates / fps
        # Exact transition of (x, x'/r) over one frame, and the noise that keeps their covariance the identity.
        transition = decay[:, None, None] * torch.stack(
            [torch.stack([1 + step, step], -1), torch.stack([-step, 1 - step], -1)], -2
        )
        identity = torch.eye(2)
        noise = torch.linalg.cholesky(identity - transition @ transition.mT + 1e-7 * identity)
        state = torch.randn(count, len(self.rates), 2, 1, generator=generator)
        components = [state[..., 0, 0]]
        for _ in range(frames - 1):
            state = transition @ state + noise @ torch.randn(state.shape, generator=generator)
            components.append(state[..., 0, 0])
        return self._pose(torch.stack(components)).transpose(0, 1).contiguous()

    def _pose(self, components: Float[Tensor, "f b c"]) -> Float[Tensor, "f b 81"]:
        """Body poses of components; continuous along the first axis."""
        offsets = self._quantile(components @ self.loadings.T).unflatten(-1, (27, 3))
        mean = matrix_from_axis_angle(self.mean_pose.unflatten(-1, (27, 3)))
        return pose_from_matrices(mean @ matrix_from_axis_angle(offsets))

    def _quantile(self, score: Float[Tensor, "*b 81"]) -> Float[Tensor, "*b 81"]:
        """Linear interpolation in each column's table."""
        spacing = self.scores[1] - self.scores[0]
        position = ((score - self.scores[0]) / spacing).clamp(0, len(self.scores) - 1)
        below = position.long().clamp(max=len(self.scores) - 2)
        columns = torch.arange(81, device=below.device).expand_as(below)
        low, high = self.quantiles[below, columns], self.quantiles[below + 1, columns]
        return torch.lerp(low, high, position - below)


def load_pose_prior() -> PosePrior:
    """The prior that the package ships (`scripts/fit_pose_prior.py`)."""
    with np.load(PRIOR_FILE, allow_pickle=False) as arrays:
        fields = ("mean_pose", "scores", "quantiles", "loadings", "rates")
        return PosePrior(**{name: torch.from_numpy(arrays[name]) for name in fields})
