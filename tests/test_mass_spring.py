import math

import pytest
import torch

from quaffure.energies import Springs, SpringStiffness
from quaffure.energies.mass_spring import energy_springs, spring_lengths, with_ghosts

STIFFNESS = SpringStiffness(k_edge=0.02, k_bend=3e-3, k_torsion=5e-4)


def zigzag(count: int = 6, angle: float = 0.5) -> torch.Tensor:
    """A coil [1 1 n 3] of edges 1 cm long."""
    turn = angle * torch.arange(count - 1, dtype=torch.float64)
    edges = 0.01 * torch.nn.functional.normalize(torch.stack([turn.cos(), turn.sin(), 0.5 * turn**0], -1), dim=-1)
    return torch.cat([torch.zeros(1, 3, dtype=torch.float64), edges.cumsum(0)])[None, None]


def energy_of(positions: torch.Tensor, posed: torch.Tensor, stiffness: SpringStiffness = STIFFNESS) -> float:
    return float(Springs(stiffness, posed).energy(positions))


def test_springs_reach_one_two_and_three_vertices() -> None:
    x = torch.tensor([0.0, 1.0, 3.0, 6.0, 10.0]).double()[None, None, :, None] * torch.tensor([0.0, 0.6, 0.8]).double()
    for reach, expected in ((1, [1, 2, 3, 4]), (2, [3, 5, 7]), (3, [6, 9])):
        torch.testing.assert_close(spring_lengths(x, reach)[0, 0].tolist(), [float(e) for e in expected])


def test_one_spring_by_hand() -> None:
    length, rest = torch.tensor([[[0.03]]]), torch.tensor([[[0.02]]])
    assert energy_springs(length, rest, 4.0).item() == pytest.approx(0.5 * 4 * 0.02 * 0.5**2)


def test_uniform_stretch_by_hand() -> None:
    straight = torch.linspace(0, 0.04, 5).double()[None, None, :, None] * torch.tensor([0.0, 0.0, -1.0]).double()
    # Edge springs: 4. Bending: 3 along the strand, and one to the ghost behind the root, 1 cm of whose 2 cm stretches.
    # Torsion: 2 along it, and two to ghosts.
    strain = 0.1
    along = 0.5 * 0.01 * strain**2
    expected = 0.02 * 4 * along
    expected += 3e-3 * (3 * 2 * along + 0.5 * 0.02 * (strain / 2) ** 2)
    expected += 5e-4 * (2 * 3 * along + 0.5 * 0.03 * ((strain / 3) ** 2 + (2 * strain / 3) ** 2))
    assert energy_of((1 + strain) * straight, straight) == pytest.approx(expected)


def test_ghosts_mirror_the_posed_strand_through_its_root_and_stay_with_the_head() -> None:
    posed = zigzag() + 0.3
    moved = posed + 0.01 * torch.randn(posed.shape, generator=torch.Generator().manual_seed(0)).double()
    ghosts = with_ghosts(moved, posed)[0, 0, :2] - posed[0, 0, 0]
    torch.testing.assert_close(ghosts, -(posed[0, 0, 1:3] - posed[0, 0, 0]).flip(0))


def test_bending_spring_is_as_stiff_as_its_docstring_says() -> None:
    rest_angle, change, length = 0.8, 1e-4, 0.01

    def bent(angle: float) -> torch.Tensor:
        edges = length * torch.tensor([[1, 0, 0], [math.cos(angle), math.sin(angle), 0]], dtype=torch.float64)
        return torch.cat([torch.zeros(1, 3).double(), edges.cumsum(0)])[None, None]

    only_bend = SpringStiffness(k_edge=0.0, k_bend=2e-3, k_torsion=0.0)
    bending = 2e-3 * length**2 * math.sin(rest_angle / 2) ** 2 / (2 * math.cos(rest_angle / 2))
    energy = energy_of(bent(rest_angle + change), bent(rest_angle), only_bend)
    assert energy == pytest.approx(0.5 * bending / length * change**2, rel=1e-3)
    assert energy_of(bent(change), bent(0.0), only_bend) < 1e-6 * energy


def test_clamp_resists_a_turn_of_a_curly_strand_about_its_root() -> None:
    posed = zigzag()
    for axis in torch.eye(3, dtype=torch.float64):
        cross = torch.linalg.cross(axis.expand(3, 3), torch.eye(3, dtype=torch.float64)).mT
        turn = torch.linalg.matrix_exp(0.3 * cross)
        assert energy_of(posed @ turn.mT, posed) > 1e-10
