import math
from dataclasses import replace

import pytest
import torch

from quaffure import HairMaterial
from quaffure.backend import Backend
from quaffure.energies import (
    HairEnergy,
    energy_body_collision,
    energy_gravity,
    energy_self_collision,
    energy_stretch,
    energy_stretch_shear,
)
from quaffure.energies.force_limit import MAX_FORCE, clip_gradients
from quaffure.energies.gravity import energy_gravity_above_root
from quaffure.energies.pose_regularization import energy_pose_regularization
from quaffure.energies.rest_state import rest_state
from quaffure.energies.self_collision import (
    densities,
    density_excesses,
    kernel_volume,
    smoothing_kernel,
)
from quaffure.energies.stretch_shear import orientation_errors
from quaffure.geometry import directors
from quaffure.geometry.signed_distance import signed_distance
from tests.scenes import (
    bent_inwards,
    posed_scene,
    sphere_groom,
    sphere_surface,
    strands_round_sphere,
    surface_on,
)

MATERIAL = HairMaterial(k_self_collision=1e-5, smoothing_length=0.03)


def rotation_about_axis(axis: list[float], angle: float) -> torch.Tensor:
    x, y, z = axis
    skew = torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=torch.float64)
    return torch.linalg.matrix_exp(skew * angle)


@pytest.fixture
def scene() -> dict[str, torch.Tensor]:
    groom = sphere_groom(strands=12, vertices=8)
    positions, director = bent_inwards(groom)
    rest = rest_state(groom.rest_strands.double(), MATERIAL)
    return {
        "x": positions.double(),
        "d3": director.double(),
        "l": rest.rest_length,
        "m": rest.mass,
        "D": rest.collision_margin,
        "rho": rest.rest_density,
    }


def energies_of(x: torch.Tensor, scene: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    distance = signed_distance(x.flatten(1, 2), sphere_surface(len(x), dtype=torch.float64)).reshape(x.shape[:3])
    density = densities(x, scene["m"], MATERIAL.smoothing_length)
    return {
        "stretch_shear": energy_stretch_shear(x, scene["d3"], scene["l"], MATERIAL.k_cosserat),
        "stretch": energy_stretch(x, scene["l"], MATERIAL.k_stretch),
        "gravity": energy_gravity(x, scene["m"]),
        "body_collision": energy_body_collision(distance, scene["D"], MATERIAL.k_body_collision),
        "self_collision": energy_self_collision(density, 0.3 * scene["rho"], MATERIAL.k_self_collision),
        "pose_regularization": energy_pose_regularization(x[None] - 0.9 * x[None, :1], 1e-6),
    }


@pytest.mark.parametrize(
    "term", ["stretch_shear", "stretch", "gravity", "body_collision", "self_collision", "pose_regularization"]
)
def test_gradient_matches_central_differences(term: str, scene: dict[str, torch.Tensor]) -> None:
    x = scene["x"].requires_grad_()
    (gradient,) = torch.autograd.grad(energies_of(x, scene)[term].sum(), x)
    direction = torch.randn(x.shape, generator=torch.Generator().manual_seed(5), dtype=torch.float64)
    expected = (gradient * direction).sum()
    # The signal must not be vacuous: many vertices feel the term.
    assert (gradient.abs().sum(-1) > 0).float().mean() > 0.1
    step = 1e-7
    with torch.no_grad():
        up, down = (energies_of(x + sign * step * direction, scene)[term].sum() for sign in (1, -1))
    assert expected.abs() > 0
    torch.testing.assert_close((up - down) / (2 * step), expected, rtol=2e-5, atol=0)


def test_rigidly_posed_rest_has_no_elastic_energy(scene: dict[str, torch.Tensor]) -> None:
    turn = rotation_about_axis([0.6, 0, 0.8], 1.1)
    posed = strands_round_sphere(12, 8).double()[None] @ turn.mT + 0.3
    assert energy_stretch_shear(posed, directors(posed), scene["l"], 1.0).item() == pytest.approx(0, abs=1e-12)
    assert energy_stretch(posed, scene["l"], 1.0).item() == pytest.approx(0, abs=1e-12)


def test_elastic_energy_turns_with_the_directors_and_not_without_them(scene: dict[str, torch.Tensor]) -> None:
    turn = rotation_about_axis([0.6, 0, 0.8], 0.7)
    energy = energy_stretch_shear(scene["x"], scene["d3"], scene["l"], 1.0)
    both = energy_stretch_shear(scene["x"] @ turn.mT + 1, scene["d3"] @ turn.mT, scene["l"], 1.0)
    torch.testing.assert_close(both, energy)
    alone = energy_stretch_shear(scene["x"] @ turn.mT, scene["d3"], scene["l"], 1.0)
    assert (alone - energy).abs().min() > 0.01 * energy.max()


def test_energies_do_not_depend_on_the_order_of_strands(scene: dict[str, torch.Tensor]) -> None:
    order = torch.randperm(12, generator=torch.Generator().manual_seed(0))
    shuffled = {
        name: value[order] if name in ("l", "m", "D", "rho") else value[:, order] for name, value in scene.items()
    }
    for name, energy in energies_of(scene["x"], scene).items():
        torch.testing.assert_close(energies_of(shuffled["x"], shuffled)[name], energy, msg=name)


def test_one_stretched_edge_by_hand() -> None:
    x = torch.tensor([[[[0, 0, 0], [0, 0, -0.03]]]], dtype=torch.float64)
    length = torch.tensor([[0.02]], dtype=torch.float64)
    director = torch.tensor([[[[0, 0, -1.0]]]], dtype=torch.float64)
    assert energy_stretch(x, length, 4.0).item() == pytest.approx(0.5 * 4 * 0.01**2)
    assert energy_stretch_shear(x, director, length, 3.0).item() == pytest.approx(0.5 * 3 * 0.5**2)
    assert energy_gravity(x, torch.tensor([[1.0, 2.0]], dtype=torch.float64)).item() == pytest.approx(-2 * 9.81 * 0.03)
    assert orientation_errors(x, -director).item() == pytest.approx(180)


def test_gravity_above_the_root_differs_by_a_constant(scene: dict[str, torch.Tensor]) -> None:
    x = scene["x"]
    difference = energy_gravity(x, scene["m"]) - energy_gravity_above_root(x, scene["m"])
    torch.testing.assert_close(difference, (scene["m"] * 9.81 * x[:, :, :1, 2]).sum((1, 2)))


def test_no_contact_energy_beyond_the_margin() -> None:
    distance = torch.tensor([[[0.0031, 0.003, 0.0029, -0.01]]], dtype=torch.float64)
    margin = torch.full((1, 4), 0.003, dtype=torch.float64)
    assert energy_body_collision(distance[..., :2], margin[:, :2], 10.0).item() == 0
    assert energy_body_collision(distance, margin, 10.0).item() == pytest.approx(10 * (1e-4**3 + 0.013**3))


def test_kernel_is_smooth_at_its_joints_and_integrates_to_its_volume() -> None:
    h = 0.7
    r = torch.tensor([h - 1e-9, h + 1e-9, 2 * h - 1e-9, 2 * h + 1e-9], dtype=torch.float64, requires_grad=True)
    value = smoothing_kernel(r, h)
    (slope,) = torch.autograd.grad(value.sum(), r, create_graph=True)
    (curvature,) = torch.autograd.grad(slope.sum(), r)
    for derivative in (value, slope, curvature):
        torch.testing.assert_close(derivative[::2], derivative[1::2], atol=1e-6, rtol=0)
    torch.testing.assert_close(smoothing_kernel(torch.zeros(1), h), torch.full((1,), 4.0))
    radius = torch.linspace(0, 2 * h, 20001, dtype=torch.float64)
    volume = torch.trapezoid(4 * math.pi * radius**2 * smoothing_kernel(radius, h), radius)
    assert volume.item() == pytest.approx(kernel_volume(h), rel=1e-6)


def test_density_of_a_uniform_block_is_its_mass_over_its_volume() -> None:
    axis = torch.arange(20, dtype=torch.float64) * 0.004
    block = torch.cartesian_prod(axis, axis, axis)[None, None]
    density = densities(block, torch.full((1, 8000), 2e-6, dtype=torch.float64), 0.008)
    middle = (block[0, 0] - axis.mean()).abs().max(dim=1).values < 0.02
    torch.testing.assert_close(density[0, 0, middle].mean().item(), 2e-6 / 0.004**3, rtol=0.01, atol=0)


def test_masses_add_up_to_density_times_length() -> None:
    rest = rest_state(strands_round_sphere(5), HairMaterial())
    torch.testing.assert_close(rest.mass.sum(1), 6.5e-6 * rest.strand_length)
    torch.testing.assert_close(rest.mass_beyond[:, 0], rest.mass[:, 1:].sum(1))
    torch.testing.assert_close(rest.mass_beyond[:, -1], rest.mass[:, -1])


@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda", marks=pytest.mark.cuda)])
def test_compiled_kernels_and_reference_agree_in_value_and_gradient(device: str) -> None:
    groom = sphere_groom(strands=300)
    positions, _ = bent_inwards(groom)
    material = HairMaterial(k_self_collision=1e-4, smoothing_length=0.01)
    scene = posed_scene(groom, groom.rest_strands.expand(2, -1, -1, -1))
    twin_scene = replace(scene, posed=scene.posed.to(device), surface=surface_on(device, scene.surface))
    energy, twin = HairEnergy(groom, material), HairEnergy(groom.to(device), material, backend=Backend.TORCH)
    reference = twin.by_term(positions.to(device), twin_scene)
    for name, value in energy.by_term(positions, scene).items():
        assert reference[name].abs().min() > 0, name
        torch.testing.assert_close(value, reference[name].cpu(), rtol=2e-5, atol=0, msg=name)
    gradients = []
    for whole, on, at in ((energy, scene, "cpu"), (twin, twin_scene, device)):
        x = positions.to(at).clone().requires_grad_()
        (gradient,) = torch.autograd.grad(whole.total(x, on) @ torch.tensor([1.0, 2.0], device=at), x)
        gradients.append(gradient[:, :, 1:].cpu())
    assert (gradients[0] - gradients[1]).norm() < 2e-5 * gradients[1].norm()


def test_a_crowd_has_the_density_and_gradient_of_its_twin() -> None:
    groom = sphere_groom(strands=100)
    material = HairMaterial(k_self_collision=1e-4, smoothing_length=0.01)
    generator = torch.Generator().manual_seed(2)
    # Some thousand vertices within reach of each other, some alone: where nothing is dense there is no gradient.
    positions = 0.05 * torch.rand(2, 100, 24, 3, generator=generator)
    positions[:, 60:] = 3 * torch.rand(2, 40, 24, 3, generator=generator) + 1
    scene = posed_scene(groom, groom.rest_strands.expand(2, -1, -1, -1))
    gradients = []
    for backend in Backend:
        energy = HairEnergy(groom, material, backend=backend).only("self_collision")
        x = positions.clone().requires_grad_()
        (gradient,) = torch.autograd.grad(energy.total(x, scene).sum(), x)
        gradients.append(gradient)
    assert gradients[1][:, :60].norm(dim=-1).min() > 0
    assert gradients[0][:, 60:].norm(dim=-1).max() <= 1e-6 * gradients[1].norm(dim=-1).max()
    assert (gradients[0] - gradients[1]).norm() < 2e-5 * gradients[1].norm()


@pytest.mark.parametrize("strands", [15, 16, 17, 33])
def test_contact_of_any_number_of_strands_is_that_of_its_twin(strands: int) -> None:
    groom = sphere_groom(strands=strands)
    positions, _ = bent_inwards(groom, batch=3)
    scene = posed_scene(groom, groom.rest_strands.expand(3, -1, -1, -1))
    found, expected = (
        HairEnergy(groom, backend=backend).by_term(positions, scene)["body_collision"] for backend in Backend
    )
    assert expected.min() > 0
    torch.testing.assert_close(found, expected, rtol=2e-5, atol=0)


def test_each_compiled_term_has_the_gradient_of_its_twin() -> None:
    groom = sphere_groom(strands=300)
    positions, _ = bent_inwards(groom)
    scene = posed_scene(groom, groom.rest_strands.expand(2, -1, -1, -1))
    silent = {"k_cosserat": 0.0, "k_stretch": 0.0, "k_body_collision": 0.0, "k_self_collision": 0.0}
    for name in (*silent, "gravity"):
        loud = {name: getattr(HairMaterial(), name)} if name != "gravity" else {}
        material = HairMaterial(**(silent | loud), smoothing_length=0.01)
        gradients = []
        for backend in Backend:
            x = positions.clone().requires_grad_()
            (gradient,) = torch.autograd.grad(HairEnergy(groom, material, backend=backend).total(x, scene).sum(), x)
            gradients.append(gradient[:, :, 1:])
        assert (gradients[0] - gradients[1]).norm() < 2e-5 * gradients[1].norm(), name


def test_pose_regularization_by_hand() -> None:
    deformation = torch.zeros(1, 2, 1, 3, 3)
    deformation[0, 1, 0, 2] = torch.tensor([0.0, 0.02, 0.0])  # one vertex moves 2 cm between two frames
    torch.testing.assert_close(energy_pose_regularization(deformation, 5.0), torch.tensor([5.0 * 0.02**2 / 2]))


def test_scale_is_the_weight_times_the_length() -> None:
    straight = torch.zeros(1, 3, 3)
    straight[0, :, 2] = torch.tensor([0.0, -0.1, -0.2])
    groom = sphere_groom(strands=1, vertices=3)
    energy = HairEnergy(replace(groom, rest_strands=straight), HairMaterial(linear_density=1e-5))
    # Masses 0.5, 1 and 0.5 mg: a third of 2 mg, lifted by 0.2 m.
    assert energy.scale == pytest.approx(9.81 * 2e-6 / 3 * 0.2)
    torch.testing.assert_close(energy.per_vertex(torch.tensor([3 * energy.scale])), torch.ones(1))


def test_density_excess_by_hand() -> None:
    excess = density_excesses(torch.tensor([[[1.5, 0.5, 1.0]]]), torch.tensor([[1.0, 1.0, 1.0]]))
    torch.testing.assert_close(excess, torch.tensor([[[50.0, 0.0, 0.0]]]))


def test_large_forces_are_scaled_down_and_small_ones_kept() -> None:
    rest = rest_state(strands_round_sphere(2, 4), HairMaterial())
    positions = torch.zeros(1, 2, 4, 3, requires_grad=True)
    weight = 9.81 * rest.mass.sum(1)
    push = torch.zeros(1, 2, 4, 3)
    push[0, 0, 1, 0], push[0, 1, 2, 1] = 3 * weight[0], -1000 * weight[1]
    through = positions.view_as(positions)
    clip_gradients(through, rest, joules=4.0)
    (through * push / 4.0).sum().backward()
    expected = push / 4.0
    expected[0, 1, 2, 1] = -MAX_FORCE * weight[1] / 4.0
    torch.testing.assert_close(positions.grad, expected)


def test_kernels_refuse_what_is_not_finite() -> None:
    groom = sphere_groom(strands=4)
    energy, scene = HairEnergy(groom), posed_scene(groom)
    broken = groom.rest_strands[None].clone()
    broken[0, 1, 3] = float("nan")
    for part in (energy.without("self_collision"), energy.only("self_collision")):
        with pytest.raises(ValueError, match="finite"):
            part.total(broken, scene)
