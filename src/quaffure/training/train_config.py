"""Settings of a training run of the deformation decoder."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from quaffure.body.head_frame_kernels import FEATURE_COUNT
from quaffure.config import HairMaterial
from quaffure.energies.by_name import hair_terms
from quaffure.errors import InputError
from quaffure.model.network_config import NetworkConfig

MOST_BODIES = 4096
"""Limit of the bodies that a step is on, all of which are in memory at once."""
LARGEST_SEED = 2**63
LARGEST_COLLISION_MARGIN = 0.05
"""Hair farther from the body than this is not in contact with it [m]."""


@dataclass(frozen=True)
class TrainConfig:
    """One training run; saved in its folder."""

    network: NetworkConfig = field(default_factory=lambda: NetworkConfig(pose_features=FEATURE_COUNT))
    material: HairMaterial = field(default_factory=HairMaterial)
    steps: int = 20000
    """Optimizer steps in all."""
    runs: int = 4
    """Runs of consecutive frames in a step, each on a body of its own; a step's grooms are draped on all of them.
    Of each process where there are several."""
    grooms_per_step: int = 4
    """Grooms in a step, drawn at random each time; all of them where there are no more."""
    frames: int = 2
    """Consecutive frames in a run (N_pose_reg of Eq. 14)."""
    learning_rate: float = 1e-3
    """The learning rate at the start; falls to a hundredth along a cosine."""
    warmup: int = 200
    """Steps over which the learning rate rises from zero."""
    elastic: Literal["rod", "modified_cosserat", "cosserat", "mass_spring"] = "rod"
    """The energy that keeps a strand's shape: the rod that rests in its design, under loadings that are drawn anew; the
    paper's, edge by edge (Eqs. 6-8); the full rod (Eqs. 2-5), whose frames follow their edges here; or springs."""
    bf16: bool = False
    """Run the network's layers in bfloat16."""
    seed: int = 0
    log_every: int = 50
    """Steps between two rows of training.csv; each evaluates the energies once more, for their terms."""
    validate_every: int = 250
    """Steps between two validations; the best weights so far are kept."""
    save_every_seconds: float = 120.0
    """Seconds between two checkpoints that the run can be resumed from."""

    def __post_init__(self) -> None:
        hair_terms(self.elastic)
        counts = ("steps", "runs", "frames", "grooms_per_step", "log_every", "validate_every")
        refuse_impossible({name: getattr(self, name) for name in counts}, self.learning_rate, self.seed)
        if self.runs * self.frames > MOST_BODIES:
            raise InputError(
                "--runs and --frames", f"at most {MOST_BODIES} bodies in a step", f"{self.runs * self.frames}"
            )
        if self.warmup < 0:
            raise InputError("--warmup", "0 or more", f"{self.warmup}")
        if not 0 <= self.save_every_seconds < math.inf:
            raise InputError("--save-every-seconds", "0 or more", f"{self.save_every_seconds}")
        if not 0 < self.material.collision_margin <= LARGEST_COLLISION_MARGIN:
            raise InputError(
                "--collision-margin", f"up to {LARGEST_COLLISION_MARGIN} m", f"{self.material.collision_margin}"
            )


def refuse_impossible(counts: Mapping[str, int], learning_rate: float, seed: int) -> None:
    """Check the settings that all trainings have.

    Args:
        counts: by the name of the setting.

    Raises:
        InputError: a count below 1, a learning rate that is not above 0, or a seed that torch does not take.
    """
    for name, count in counts.items():
        if count < 1:
            raise InputError(f"--{name.replace('_', '-')}", "1 or more", f"{count}")
    if not 0 < learning_rate < math.inf:
        raise InputError("--learning-rate", "a number above 0", f"{learning_rate}")
    if not 0 <= seed < LARGEST_SEED:
        raise InputError("--seed", f"0 or more, below {LARGEST_SEED}", f"{seed}")
