"""How all networks are trained: Adam with clipped gradients, and an average of the weights on the way."""

import math
from collections.abc import Callable, Mapping
from typing import Any, Generic, TypeVar, cast

import torch
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel

from quaffure.errors import InputError

Network = TypeVar("Network", bound=nn.Module)
LARGEST_GRADIENT = 1.0
"""Norm that gradients are clipped to."""
MOST_SKIPPED = 10
"""Updates left out in a row at which a training is given up."""


class AveragedAdam(Generic[Network]):
    """Adam on a network, and the exponential average of its weights, which is steadier than they are.

    Attributes:
        skipped: how many updates were left out so far, because a gradient was not finite.
    """

    def __init__(self, network: Network, learning_rate: float, ema_decay: float) -> None:
        """
        Args:
            learning_rate: at the start.
            ema_decay: share of the average that is kept in a step; less of it at first, when it would still hold the
                weights that the network began with.
        """
        self.network, self.learning_rate = network, learning_rate
        trained = [parameter for parameter in network.parameters() if parameter.requires_grad]
        self.adam = torch.optim.Adam(trained, lr=learning_rate, betas=(0.9, 0.99))
        self._average = AveragedModel(network, avg_fn=_moving_average(ema_decay))
        self.skipped = 0
        self._skipped_in_a_row = 0

    @property
    def averaged(self) -> Network:
        """The network with averaged weights: what is validated and kept."""
        return cast(Network, self._average.module)

    def start_from(self, weights: Mapping[str, Tensor]) -> None:
        """Take over weights before the first step.

        Raises:
            RuntimeError: they are of other layers.
        """
        self.network.load_state_dict(weights)
        self.averaged.load_state_dict(weights)

    def update(self, share: float) -> float:
        """One step along the accumulated gradients, by a share of the learning rate; the gradients' norm.

        Where a gradient is not finite, all weights stay as they were: one bad batch must not end a run, which would
        meet it again whenever it is resumed.

        Raises:
            InputError: that happened `MOST_SKIPPED` times in a row.
        """
        norm = float(nn.utils.clip_grad_norm_(self.network.parameters(), LARGEST_GRADIENT))
        if not math.isfinite(norm):
            self._skip(norm)
            return norm
        self._skipped_in_a_row = 0
        for group in self.adam.param_groups:
            group["lr"] = self.learning_rate * share
        self.adam.step()
        self.adam.zero_grad(set_to_none=True)
        self._average.update_parameters(self.network)
        return norm

    def _skip(self, norm: float) -> None:
        self.adam.zero_grad(set_to_none=True)
        self.skipped += 1
        self._skipped_in_a_row += 1
        if self._skipped_in_a_row == MOST_SKIPPED:
            found = f"{norm} for {MOST_SKIPPED} steps in a row"
            raise InputError("training", "finite gradients (a lower --learning-rate may help)", found)

    def state(self) -> dict[str, Any]:
        """Everything that `restore` needs, by name."""
        return {
            "network": self.network.state_dict(),
            "average": self._average.state_dict(),
            "optimizer": self.adam.state_dict(),
            "skipped": self.skipped,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from what `state` gave.

        Raises:
            KeyError, RuntimeError, ValueError: it is of another network.
        """
        self.network.load_state_dict(state["network"])
        self._average.load_state_dict(state["average"])
        self.adam.load_state_dict(state["optimizer"])
        # Checkpoints made before updates were skipped do not count them.
        self.skipped = int(state.get("skipped", 0))


def warm_cosine(step: int, warmup: int, steps: int) -> float:
    """Share of the learning rate: a linear rise, then a cosine down to a hundredth."""
    return min(1.0, (step + 1) / max(1, warmup)) * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * step / steps)))


def _moving_average(ema_decay: float) -> Callable[[Tensor, Tensor, Tensor | int], Tensor]:
    def average(kept: Tensor, new: Tensor, count: Tensor | int) -> Tensor:
        return kept.lerp(new, max(1 - ema_decay, 9 / (10 + float(count))))

    return average
