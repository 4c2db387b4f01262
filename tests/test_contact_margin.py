"""Contact at margins far beyond the distance that free cells of the occupancy grid keep from the body."""

from dataclasses import replace

import pytest
import torch

from quaffure import HairMaterial, InputError
from quaffure.energies import RestState, energy_body_collision
from quaffure.energies.fused_strand import TERMS, strand_energy
from quaffure.energies.rest_state import rest_state
from quaffure.geometry import Surface, directors, posed_surface, surface_topology
from quaffure.geometry.signed_distance import signed_distance
from quaffure.solvers import AdamDraper, XpbdDraper, XpbdSetting
from quaffure.training import TrainConfig
from tests.scenes import posed_scene, sphere_groom, sphere_mesh

MARGINS = (0.02, 0.05)
GROOM = sphere_groom(strands=30)


def surface_partly_off_the_grid() -> Surface:
    """A sphere of radius 0.1 m; the occupancy grid ends in its middle."""
    vertices, faces = sphere_mesh(count=2000)
    return posed_surface(surface_topology(vertices, faces), vertices[None], torch.tensor([[0.64, 0.0, 0.0]]))


def positions(least: float, most: float) -> torch.Tensor:
    """Vertices all round the sphere at distances [m] from `least` to `most`, [1 s n 3]."""
    generator = torch.Generator().manual_seed(2)
    outward = torch.nn.functional.normalize(torch.randn(1, *GROOM.rest_strands.shape, generator=generator), dim=-1)
    distance = least + (most - least) * torch.rand(*outward.shape[:3], 1, generator=generator)
    distance[:, :, 0] = 0.01  # roots have no margin
    return outward * (0.1 + distance)


def rest_with_margin(margin: float) -> tuple[RestState, HairMaterial]:
    """Contact alone, at the same margin for all vertices but the roots."""
    material = HairMaterial(k_cosserat=0.0, k_stretch=0.0, collision_margin=margin)
    rest = rest_state(GROOM.rest_strands, material)
    full = torch.full_like(rest.collision_margin, margin)
    full[:, 0] = 0
    return replace(rest, collision_margin=full), material


def contact_energy(x: torch.Tensor, margin: float, surface: Surface) -> torch.Tensor:
    rest, material = rest_with_margin(margin)
    total, terms = strand_energy(x, directors(GROOM.rest_strands[None]), rest, material, surface)
    gravity = terms[:, TERMS.index("gravity")]
    # Gravity's gradient stays in; its value is taken out.
    return total - gravity


@pytest.mark.parametrize("margin", MARGINS)
@pytest.mark.parametrize(("least", "most"), [(0.01, 0.04), (-0.03, 0.0), (-0.02, 0.04)])
def test_energy_and_gradient_are_those_of_the_formula(margin: float, least: float, most: float) -> None:
    surface, x = surface_partly_off_the_grid(), positions(least, most)
    on_grid = x[..., 0] > 0
    assert 0.3 < on_grid.float().mean() < 0.7
    rest, material = rest_with_margin(margin)
    distance = signed_distance(x.flatten(1, 2), surface).reshape(x.shape[:3])
    assert ((distance < margin) & (distance > 0.006) & on_grid).sum() > 50 or most <= 0
    gradients, energies = [], []
    for formula in (
        lambda at: contact_energy(at, margin, surface),
        lambda at: (
            energy_body_collision(
                signed_distance(at.flatten(1, 2), surface).reshape(at.shape[:3]),
                rest.collision_margin,
                material.k_body_collision,
            )
            + (9.81 * rest.mass * (at[..., 2] - at[..., 2].detach())).sum((1, 2))
        ),
    ):
        at = x.clone().requires_grad_()
        energies.append(formula(at))
        gradients.append(torch.autograd.grad(energies[-1].sum(), at)[0][:, :, 1:])
    torch.testing.assert_close(energies[0], energies[1], rtol=5e-5, atol=0)
    assert (gradients[0] - gradients[1]).norm() < 1e-4 * gradients[1].norm()


@pytest.mark.parametrize("margin", MARGINS)
def test_gradient_agrees_with_central_differences(margin: float) -> None:
    surface, x = surface_partly_off_the_grid(), positions(0.01, 0.04).requires_grad_()
    (gradient,) = torch.autograd.grad(contact_energy(x, margin, surface).sum(), x)
    mass, signal = rest_with_margin(margin)[0].mass, 0.0
    for axis in range(3):
        step = torch.zeros(3)
        step[axis] = 1e-4
        ahead, behind = (float(contact_energy(x.detach() + sign * step, margin, surface)) for sign in (1, -1))
        by_hand = float(gradient[:, :, 1:, axis].sum())
        if axis == 2:
            by_hand -= 9.81 * float(mass[:, 1:].sum())
        assert (ahead - behind) / 2e-4 == pytest.approx(by_hand, rel=2e-3, abs=2e-3 * float(gradient.abs().sum()) / 50)
        signal = max(signal, abs(by_hand))
    assert signal > 1e-3


@pytest.mark.parametrize("margin", MARGINS)
def test_xpbd_and_adam_leave_hair_at_the_same_equilibrium(margin: float) -> None:
    groom = sphere_groom(strands=24)
    material = HairMaterial(k_cosserat=1e-8, k_self_collision=0.0, collision_margin=margin, collision_ramp=1.0)
    scene = posed_scene(groom)
    setting = XpbdSetting(steps=200, iterations=50, first_time_step=0.1, last_time_step=0.002, refresh=10)
    settled, report = XpbdDraper(material, setting).solve(scene)
    adam, expected = AdamDraper(material, steps=600).solve(scene)
    by_xpbd, by_adam = (x[0, :, 4:].norm(dim=-1) - 0.1 for x in (settled, adam))
    # Hair rests at a distance where cells are free, pushed by the margin alone.
    resting = (by_adam > 0.6 * margin) & (by_adam < margin)
    assert resting.sum() > 50
    assert (by_xpbd - by_adam)[resting].abs().mean() < 0.01 * margin
    assert report.energy == pytest.approx(expected.energy, rel=0.02)


def test_training_accepts_margins_up_to_5_cm() -> None:
    for margin in (0.006, 0.05):
        assert TrainConfig(material=HairMaterial(collision_margin=margin)).material.collision_margin == margin
    with pytest.raises(InputError, match="collision-margin"):
        TrainConfig(material=HairMaterial(collision_margin=0.051))
