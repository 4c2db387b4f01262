import math

import pytest
import torch

from benchmarks.rods.elastic_potentials import MODELS, ElasticPotential, cosserat
from quaffure import InputError
from quaffure.energies import ELASTIC_MODELS, RodStiffness, hair_terms
from quaffure.energies.cosserat import (
    bend_twist_strain,
    cosserat_stretch_shear_strain,
    energy_bend_twist,
    energy_cosserat_stretch_shear,
    energy_unit_quaternion,
    nearer_sign,
    relative_rotations,
    strain_angles,
    third_axis,
    transported_frames,
)
from quaffure.geometry import directors, matrix_from_axis_angle, quaternion_from_matrix, quaternion_multiply
from tests.scenes import strands_round_sphere

TURN = matrix_from_axis_angle(torch.tensor([1.3, -0.7, 2.0], dtype=torch.float64))
STIFF = RodStiffness(stretch_shear=0.02, bend=8e-9, twist=3e-9, k_unit_quaternion=1e-4)


def posed_strands() -> tuple[torch.Tensor, torch.Tensor]:
    """Wavy strands [1 s n 3] and their rest lengths [s e] of ten vertices each, in float64."""
    posed = strands_round_sphere(strands=5, vertices=10).double()[None] @ TURN.mT
    return posed, posed[0].diff(dim=1).norm(dim=-1)


def disturbed(state: ElasticPotential, posed: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Positions and unknowns of two samples, well away from rest."""
    generator = torch.Generator().manual_seed(2)
    x = posed.expand(2, -1, -1, -1) + 0.004 * torch.randn(2, *posed.shape[1:], generator=generator).double()
    q = state.unknowns.expand(2, -1, -1, -1)
    return x, q + 0.2 * torch.randn(q.shape, generator=generator).double()


def quaternion_about_z(angle: float) -> torch.Tensor:
    return torch.tensor([math.cos(angle / 2), 0, 0, math.sin(angle / 2)], dtype=torch.float64)


@pytest.mark.parametrize("name", list(MODELS))
def test_gradients_match_central_differences_away_from_rest(name: str) -> None:
    posed, rest_length = posed_strands()
    state = MODELS[name](posed, rest_length)
    x, unknowns = (value.requires_grad_() for value in disturbed(state, posed))
    energy = state.energy(x, unknowns)
    assert energy.shape == (2,)
    assert (energy > 1e-9).all()
    variables = [x, unknowns] if unknowns.numel() else [x]
    for variable, gradient in zip(variables, torch.autograd.grad(energy.sum(), variables)):
        assert (gradient.abs().sum(-1) > 0).all()
        direction = torch.randn(variable.shape, generator=torch.Generator().manual_seed(5), dtype=torch.float64)
        step = 1e-6
        with torch.no_grad():
            variable += step * direction
            up = state.energy(x, unknowns).sum()
            variable -= 2 * step * direction
            down = state.energy(x, unknowns).sum()
            variable += step * direction
        torch.testing.assert_close((up - down) / (2 * step), (gradient * direction).sum(), rtol=1e-5, atol=0)


@pytest.mark.parametrize("name", list(MODELS))
def test_posed_rest_is_unstrained_in_any_pose_and_disturbed_it_is_not(name: str) -> None:
    posed, rest_length = posed_strands()
    state = MODELS[name](posed, rest_length)
    at_rest, away = state.energy(posed, state.unknowns), state.energy(*disturbed(state, posed))
    assert (at_rest.abs() < 1e-16 * away.min()).all() or (at_rest.abs() < 1e-24).all()
    x = posed.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(state.energy(x, state.unknowns).sum(), x)
    assert gradient.abs().max() < 1e-12


@pytest.mark.parametrize("name", list(MODELS))
def test_energy_does_not_change_when_head_and_hair_move_rigidly_together(name: str) -> None:
    posed, rest_length = posed_strands()
    state = MODELS[name](posed, rest_length)
    x, unknowns = disturbed(state, posed)
    energy = state.energy(x, unknowns)
    for turn in (TURN, torch.diag(torch.tensor([-1.0, 1.0, -1.0], dtype=torch.float64))):
        moved_state = MODELS[name](posed @ turn.mT + 1.5, rest_length)
        moved = unknowns
        if name == "cosserat":
            # The transported frames of the moved strands are the moved frames but for a spin about their directors.
            world_from_strand = quaternion_from_matrix(turn)
            spin = quaternion_multiply(
                conjugate(moved_state.unknowns), quaternion_multiply(world_from_strand, state.unknowns)
            )
            assert spin[..., 1:3].abs().max() < 1e-7
            moved = quaternion_multiply(world_from_strand, quaternion_multiply(unknowns, conjugate(spin)))
        torch.testing.assert_close(moved_state.energy(x @ turn.mT + 1.5, moved), energy, rtol=1e-9, atol=0)
        turned_alone = (x - x[:, :, :1]) @ turn.mT + x[:, :, :1]
        assert (state.energy(turned_alone, unknowns) - energy).abs().min() > 1e-3 * energy.max()


def conjugate(quaternion: torch.Tensor) -> torch.Tensor:
    return quaternion * quaternion.new_tensor([1, -1, -1, -1])


def test_frames_follow_the_strand_without_twisting() -> None:
    posed, _ = posed_strands()
    frames = transported_frames(directors(posed))
    torch.testing.assert_close(third_axis(frames), directors(posed))
    torch.testing.assert_close(frames.norm(dim=-1), torch.ones_like(frames[..., 0]))
    relative = relative_rotations(frames)
    assert relative[..., 1:3].norm(dim=-1).min() > 1e-3
    assert relative[..., 3].abs().max() < 1e-12
    folded = torch.tensor([[[[0, 0, -1.0], [0, 0, 1.0], [0, 0, -1.0]]]], dtype=torch.float64)
    torch.testing.assert_close(third_axis(transported_frames(folded)), folded)


def test_one_bent_twisted_and_stretched_pair_by_hand() -> None:
    angle, length = 0.4, torch.tensor([[0.02, 0.02]], dtype=torch.float64)
    straight = quaternion_about_z(0.0)
    twisted = torch.stack([straight, quaternion_about_z(angle)])[None, None]
    strain = bend_twist_strain(relative_rotations(twisted), straight.view(1, 1, 1, 4), length[:, :1])
    assert strain.flatten().tolist() == pytest.approx([0, 0, 2 / 0.02 * math.sin(0.2)])
    k = STIFF.k_bend_twist(length[:, :1])
    assert energy_bend_twist(strain, k).item() == pytest.approx(0.5 * 3e-9 * 0.02 * (100 * math.sin(0.2)) ** 2)
    x = torch.tensor([[[[0, 0, 0], [0, 0, 0.025], [0.02, 0, 0.025]]]], dtype=torch.float64)
    gamma = cosserat_stretch_shear_strain(x, twisted, length)
    assert gamma.flatten().tolist() == pytest.approx([0, 0, 0.25, 1, 0, -1])
    energy = energy_cosserat_stretch_shear(gamma, STIFF.k_stretch_shear(length)).item()
    assert energy == pytest.approx(0.5 * 0.02 * 0.02 * (0.25**2 + 2))
    assert energy_unit_quaternion(1.5 * twisted, 4.0).item() == pytest.approx(0.5 * 4 * 2 * 0.25)
    assert strain_angles(relative_rotations(twisted), straight.view(1, 1, 1, 4)).item() == pytest.approx(
        math.degrees(angle)
    )


def test_a_quaternion_and_its_negative_are_one_rotation() -> None:
    posed, rest_length = posed_strands()
    state = cosserat(STIFF)(posed, rest_length)
    x, unknowns = disturbed(state, posed)
    signs = torch.where(torch.arange(9) % 2 == 0, 1.0, -1.0).double()[:, None]
    torch.testing.assert_close(state.energy(x, signs * unknowns), state.energy(x, unknowns))


def test_bending_by_the_rest_angle_to_the_wrong_side_is_not_taken_for_rest() -> None:
    rest, mirrored = (quaternion_about_z(angle).view(1, 1, 1, 4) for angle in (0.3, -0.3))
    length = torch.tensor([[0.01]], dtype=torch.float64)
    strain = bend_twist_strain(mirrored, rest, length)
    assert strain[..., 2].item() == pytest.approx(-200 * 2 * math.sin(0.15))
    torch.testing.assert_close(nearer_sign(-mirrored, rest), mirrored)


def test_clamp_resists_a_turn_of_the_whole_strand() -> None:
    posed, rest_length = posed_strands()
    state = cosserat(STIFF)(posed, rest_length)
    angle = 0.3
    turn = matrix_from_axis_angle(angle * directors(posed)[0, 0, 0])
    x = (posed - posed[:, :, :1]) @ turn.mT + posed[:, :, :1]
    q = quaternion_multiply(quaternion_from_matrix(turn), state.unknowns)
    # The first strand turns about its own first edge: pure twist over half that edge.
    one = cosserat(STIFF)(posed[:, :1], rest_length[:1])
    energy = one.energy(x[:, :1], q[:, :1]).item()
    half = 0.5 * rest_length[0, 0].item()
    assert energy == pytest.approx(0.5 * 3e-9 * half * (2 / half * math.sin(angle / 2)) ** 2, rel=1e-6)


def test_unknown_model_is_refused_with_the_names() -> None:
    with pytest.raises(InputError, match="modified_cosserat, cosserat, mass_spring"):
        hair_terms("rubber")
    assert set(MODELS) < set(ELASTIC_MODELS)
