"""What surrounds each vertex: the density of hair there, and the distance that it is to keep from the body.

The density of Eq. 12 is taken on a coarse grid that repeats itself through space, so that memory does not depend on the
pose: masses are spread over the eight nearest nodes, and read from them. With the same tent for both, the mean
over all positions of the grid is the cubic B-spline with knots a cell apart, close to the kernel of Eq. 13.
"""

from typing import NamedTuple

import numpy as np
import torch

from quaffure.model.network_config import DensityGridConfig
from quaffure.model.surroundings_kernels import NODES, GridUnits
from quaffure.types import Float, Positions, RestLengths, Tensor


class Surroundings(NamedTuple):
    """What the surroundings of strands are measured against.

    Attributes:
        rest_length: of the edges [m].
        mass: of the vertices [kg].
        rest_density: `coarse_density` of the design [kg/m^3].
        margin: distance from the body that each vertex is to keep [m].
    """

    rest_length: RestLengths
    mass: Float[Tensor, "s n"]
    rest_density: Float[Tensor, "s n"]
    margin: Float[Tensor, "s n"]


def surroundings_reference(
    positions: Positions, strands: Surroundings, config: DensityGridConfig
) -> Float[Tensor, "b s e 5"]:
    """Torch twin of `write_surroundings`: asinh of the excess density, the gradient, as long as the asinh of its
    length, and the margin.

    Args:
        positions: in the head's frame [m].
    """
    density, slope = coarse_density(positions, strands.mass, config.cell)
    excess = ((density - strands.rest_density) / config.excess_unit).asinh()
    size = slope.square().sum(dim=-1, keepdim=True).clamp(min=1e-12).sqrt() / config.slope_unit
    margin = (strands.margin / config.margin_unit).expand_as(excess)
    turned = slope / config.slope_unit * size.asinh() / size
    return torch.cat([excess[..., None], turned, margin[..., None]], dim=-1)[:, :, 1:]


def coarse_density(
    positions: Positions, mass: Float[Tensor, "s n"], cell: float
) -> tuple[Float[Tensor, "b s n"], Float[Tensor, "b s n 3"]]:
    """Density on the grid at every vertex [kg/m^3], and its gradient [kg/m^4].

    Args:
        positions: in the head's frame [m].
        mass: of every vertex [kg].
        cell: side of a cell [m].
    """
    places = positions / cell
    first = places.floor()
    share = places - first
    nodes = positions.new_tensor(NODES, dtype=torch.long)
    density, slope = torch.zeros_like(share[..., 0]), torch.zeros_like(share)
    corners = []
    for corner in torch.cartesian_prod(*[torch.arange(2, device=positions.device)] * 3):
        i, j, k = ((first.long() + corner) & (nodes - 1)).unbind(-1)
        along = torch.where(corner == 1, share, 1 - share)
        corners.append(((i * NODES[1] + j) * NODES[2] + k, along, 2.0 * corner - 1))
    for sample in range(len(positions)):
        grid = positions.new_zeros(NODES[0] * NODES[1] * NODES[2])
        for node, along, _ in corners:
            grid = grid.index_add(0, node[sample].flatten(), (mass * along[sample].prod(-1)).flatten() / cell**3)
        for node, along, sign in corners:
            value, (x, y, z) = grid[node[sample]], along[sample].unbind(-1)
            density[sample] = density[sample] + value * x * y * z
            turned = torch.stack([y * z, x * z, x * y], dim=-1) * sign
            slope[sample] = slope[sample] + value[..., None] * turned / cell
    return density, slope


def grid_units(config: DensityGridConfig) -> GridUnits:
    """The configuration as the kernels take it."""
    per_slope = 1 / (config.cell * config.slope_unit)
    return GridUnits(*map(np.float32, (1 / config.cell, 1 / config.excess_unit, per_slope, 1 / config.margin_unit)))
