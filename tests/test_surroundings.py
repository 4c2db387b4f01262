"""What the network reads of a strand's surroundings: the kernel against its twin, and both against cases by hand."""

import numpy as np
import pytest
import torch
from numba import get_num_threads

from quaffure import HairMaterial
from quaffure.body import BodyModel
from quaffure.geometry import integrate_directions
from quaffure.model.initial_shape import bits
from quaffure.model.network_config import DensityGridConfig
from quaffure.model.prepared_groom import surroundings_of
from quaffure.model.surroundings import (
    Surroundings,
    coarse_density,
    grid_units,
    surroundings_reference,
)
from quaffure.model.surroundings_kernels import NODES, SURROUNDING_FEATURES, write_surroundings
from tests.scenes import few_strands

VERTICES = 6
GRID = DensityGridConfig()


def random_strands(count: int = 200) -> tuple[torch.Tensor, torch.Tensor, Surroundings]:
    """Roots, unit edges and what surroundings are measured against, in a space of a few cells."""
    generator = torch.Generator().manual_seed(0)
    roots = 0.06 * torch.rand(2, count, 3, generator=generator) - 0.03
    edges = torch.nn.functional.normalize(torch.randn(2, count, VERTICES - 1, 3, generator=generator), dim=-1)
    length = 0.002 + 0.01 * torch.rand(count, VERTICES - 1, generator=generator)
    mass, rest, margin = (torch.rand(count, VERTICES, generator=generator) for _ in range(3))
    return roots, edges, Surroundings(length, 1e-6 * mass, 5 * rest, 0.02 * margin)


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float32, 1e-4), (torch.bfloat16, 0.02)])
def test_the_kernel_is_its_twin(dtype: torch.dtype, tolerance: float) -> None:
    roots, edges, strands = random_strands()
    # The last columns of more, as in a drape.
    own = 3
    features = torch.full((2, len(strands.mass), own + SURROUNDING_FEATURES * (VERTICES - 1)), torch.nan, dtype=dtype)
    around, vectors = tuple(map(torch.Tensor.numpy, strands)), (roots.numpy(), edges.numpy())
    write_surroundings(around, *vectors, grid_units(GRID), get_num_threads(), bits(features)[..., own:])
    positions = integrate_directions(roots, edges, strands.rest_length)
    expected = surroundings_reference(positions, strands, GRID).flatten(2)
    assert expected.std() > 0.5
    torch.testing.assert_close(features[..., own:].float(), expected, atol=tolerance, rtol=tolerance)
    assert features[..., :own].isnan().all()


def test_the_gradient_is_that_of_the_density() -> None:
    """Of the field that all other vertices make, at a vertex that weighs nothing."""
    roots, edges, strands = random_strands()
    positions = integrate_directions(roots, edges, strands.rest_length)[:1].double()
    mass = strands.mass.double()
    mass[0] = 0.0
    _, slope = coarse_density(positions, mass, GRID.cell)
    for axis in range(3):
        step = torch.zeros(3, dtype=torch.float64)
        step[axis] = 1e-7
        ahead, behind = positions.clone(), positions.clone()
        ahead[0, 0] += step
        behind[0, 0] -= step
        change = coarse_density(ahead, mass, GRID.cell)[0] - coarse_density(behind, mass, GRID.cell)[0]
        difference = change[0, 0] / 2e-7
        torch.testing.assert_close(slope[0, 0, :, axis], difference, rtol=1e-5, atol=1e-3)


def test_mass_is_kept_and_space_repeats_itself() -> None:
    """A vertex in a node's place finds its own mass in one cell, wherever it is."""
    mass = torch.tensor([[2e-6]])
    for node in ([0, 0, 0], [-3, 5, 70], [200, -90, 1000]):
        density, slope = coarse_density(
            GRID.cell * torch.tensor(node).reshape(1, 1, 1, 3).double(), mass.double(), GRID.cell
        )
        assert float(density) == pytest.approx(2e-6 / GRID.cell**3, rel=1e-4)
        assert slope.shape == (1, 1, 1, 3)
    apart = GRID.cell * torch.tensor([[0.5, 0.5, 0.5], [0.5 + NODES[0], 0.5, 0.5]]).double()[None, :, None]
    both, _ = coarse_density(apart, mass.double().expand(2, 1), GRID.cell)
    alone, _ = coarse_density(apart[:, :1], mass.double(), GRID.cell)
    assert both[0, 0, 0] == pytest.approx(2 * float(alone), rel=1e-6)


def test_the_design_upright_is_in_excess_nowhere(body: BodyModel) -> None:
    groom = few_strands(body)
    margin = torch.full(groom.rest_strands.shape[:2], 2 * GRID.margin_unit)
    strands = surroundings_of(groom, body, HairMaterial(), margin, GRID)
    head = body.posed_joints(torch.zeros(1, 81), torch.zeros(1, 10))[1][0, body.joint_names.index("Head")]
    features = surroundings_reference((groom.rest_strands - head)[None], strands, GRID)
    assert features[..., 0].abs().max() < 1e-4
    assert features[..., 1:4].abs().mean() > 0.01
    np.testing.assert_allclose(features[..., 4], 2.0, rtol=1e-5)
