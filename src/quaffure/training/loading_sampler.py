"""Loadings for training steps: stiffness, gravity and wind, drawn anew for every groom of a step."""

import math

import torch

from quaffure.config import STANDARD_GRAVITY
from quaffure.energies.loading import STANDARD_LOADING, Loading

STANDARD_SHARE = 0.5
"""Share of draws that are human hair under gravity alone."""
STIFFNESS_RANGE = 3.0
"""Largest factor by which hair is stiffer or softer."""
ACCELERATION_RANGE = 2.0
"""Largest factor by which the acceleration is more or less than gravity's."""
MOST_TILT = math.radians(130.0)
"""Largest angle between the acceleration and down [rad]. To hair, a body that bows in still air is one that stands in
such a wind, and few poses of the prior bow."""


def draw_loading(generator: torch.Generator) -> Loading:
    """A loading; stiffness and size of the acceleration are uniform in their logarithms, its tilt in its angle."""
    if float(torch.rand((), generator=generator)) < STANDARD_SHARE:
        return STANDARD_LOADING
    stiffness, size, tilt, azimuth = torch.rand(4, generator=generator).tolist()
    pull, tilt, azimuth = (
        STANDARD_GRAVITY * ACCELERATION_RANGE ** (2 * size - 1),
        MOST_TILT * tilt,
        2 * math.pi * azimuth,
    )
    across = pull * math.sin(tilt)
    acceleration = across * math.cos(azimuth), across * math.sin(azimuth), -pull * math.cos(tilt)
    return Loading(STIFFNESS_RANGE ** (2 * stiffness - 1), acceleration)
