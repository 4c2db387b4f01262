"""A user's own energy term, in every total, gradient, solver and training."""

from dataclasses import dataclass, replace

import pytest
import torch

from quaffure import HairMaterial, InputError
from quaffure.backend import Backend, choose_backend
from quaffure.body import BodyModel, load_pose_prior
from quaffure.energies import STANDARD_LOADING, EnergyTerm, Gravity, HairEnergy, HairState, hair_terms
from quaffure.scene import BodyBatch, HairScene, Scene
from quaffure.solvers import AdamDraper, DescentDraper, LbfgsDraper, XpbdDraper
from quaffure.training import DecoderRecipe, GroomedBody, PoseSampler
from quaffure.types import Energy, Float, Tensor
from tests.scenes import bent_inwards, posed_scene, sphere_groom
from tests.training_runs import TINY, tiny_groom, validation


@dataclass(frozen=True)
class PointSpring(EnergyTerm):
    """A spring from one vertex of one strand to a point [m]; `stiffness` [N/m]."""

    name = "point_spring"
    equation = "Hooke's law"
    metric_unit = "mm"
    point: tuple[float, float, float]
    strand: int = 1
    vertex: int = -1
    stiffness: float = 100.0

    def energy(self, hair: HairState, scene: HairScene) -> Energy:
        return 0.5 * self.stiffness * self._offset(hair).square().sum(-1)

    def metric(self, hair: HairState, scene: HairScene) -> Float[Tensor, " b"]:
        return 1000 * self._offset(hair).norm(dim=-1)

    def _offset(self, hair: HairState) -> Float[Tensor, "b 3"]:
        return hair.positions[:, self.strand, self.vertex] - hair.positions.new_tensor(self.point)


SPRING = PointSpring((0.1, 0.2, 0.3))


@dataclass(frozen=True)
class MoonGravity(Gravity):
    """Another formula under the name of a compiled term."""

    def energy(self, hair: HairState, scene: HairScene) -> Energy:
        return super().energy(hair, scene) / 6


def test_a_backend_is_chosen_by_device_and_number_type() -> None:
    assert choose_backend(torch.zeros(1)) is Backend.CPU
    assert choose_backend(torch.zeros(1, dtype=torch.float64)) is Backend.TORCH
    assert choose_backend(torch.zeros(1, device="meta")) is Backend.TORCH


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_total_has_the_terms_energy_and_gradient(dtype: torch.dtype) -> None:
    groom = sphere_groom(strands=20)
    groom = replace(groom, rest_strands=groom.rest_strands.to(dtype))
    scene = posed_scene(groom)
    energy = HairEnergy(groom, terms=(*hair_terms(), SPRING))
    assert (energy.backend is Backend.CPU) == (dtype == torch.float32)
    x = scene.posed.clone().requires_grad_()
    total = energy.total(x, scene)
    (gradient,) = torch.autograd.grad(total.sum(), x)
    step = torch.zeros_like(gradient)
    step[:, 1, -1] = gradient.new_tensor([1e-3, -2e-3, 5e-4])
    with torch.no_grad():
        difference = energy.total(x + step, scene) - energy.total(x - step, scene)
    torch.testing.assert_close(difference.sum(), 2 * (gradient * step).sum(), rtol=1e-3, atol=0)
    report = energy.by_term(x, scene)
    assert list(report) == ["stretch_shear", "stretch", "gravity", "body_collision", "self_collision", "point_spring"]
    torch.testing.assert_close(sum(report.values()), total.detach(), rtol=1e-5, atol=0)
    expected = 0.5 * 100 * (scene.posed[:, 1, -1] - x.new_tensor(SPRING.point)).square().sum(-1)
    torch.testing.assert_close(report["point_spring"], expected)
    torch.testing.assert_close(energy.metrics(x, scene)["point_spring"], 1000 * (expected / 50).sqrt())


@pytest.mark.parametrize(
    "make",
    [lambda terms: AdamDraper(steps=200, terms=terms), lambda terms: LbfgsDraper(terms=terms)],
    ids=["adam", "lbfgs"],
)
def test_a_stiff_spring_brings_its_vertex_to_the_point(make: type[DescentDraper]) -> None:
    scene = posed_scene(sphere_groom(strands=12))
    end, root = scene.posed[0, 1, -1], scene.posed[0, 1, 0]
    sideways = torch.linalg.cross(end - root, torch.tensor([0.3, 0.5, 0.8]))
    point = root + 0.8 * (end - root) + 0.05 * torch.nn.functional.normalize(sideways, dim=0)
    spring = PointSpring((float(point[0]), float(point[1]), float(point[2])))
    draped = make((*hair_terms(), spring)).drape(scene)
    assert (end - point).norm() > 0.05
    assert (draped[0, 1, -1] - point).norm() < 1e-3


def test_the_training_loss_reaches_the_networks_weights_through_a_term(body: BodyModel) -> None:
    groom, config = tiny_groom(body), replace(TINY, material=HairMaterial(k_pose_reg=0.0))
    bodies = BodyBatch(body, *PoseSampler(load_pose_prior()).sample(1, 2, torch.Generator().manual_seed(0)))
    recipe = DecoderRecipe(
        config, (GroomedBody(body, (groom,)),), PoseSampler(load_pose_prior()), validation(), terms=(SPRING,)
    )
    objective, terms = recipe._objective(Scene(groom, bodies), recipe.energies[0], STANDARD_LOADING, 1, 0)
    objective.backward()
    assert terms["point_spring"] == pytest.approx(terms["loss"], rel=1e-4)
    last = recipe.network.strand[-1]
    assert last.weight.grad.norm() > 0  # type: ignore[union-attr, operator]


def test_a_solver_that_cannot_project_a_term_refuses_it_by_name() -> None:
    assert XpbdDraper(terms=hair_terms()).name == "xpbd"
    some_terms = tuple(term for term in hair_terms() if not isinstance(term, Gravity))
    for terms, found in (
        ((*hair_terms(), SPRING), "found point_spring"),
        (hair_terms("cosserat"), "found elastic, no stretch_shear, no stretch"),
        ((*some_terms, MoonGravity()), "found gravity, no gravity"),
        (some_terms, "found no gravity"),
    ):
        with pytest.raises(InputError, match=f"^solver xpbd: .*{found}$") as error:
            XpbdDraper(terms=terms)
        assert "\n" not in str(error.value)


def test_a_subclass_of_a_compiled_term_runs_with_its_own_formula() -> None:
    groom = sphere_groom(strands=5)
    scene, (positions, _) = posed_scene(groom), bent_inwards(groom, batch=1)
    earth, moon = (HairEnergy(groom, terms=(term,)).total(positions, scene) for term in (Gravity(), MoonGravity()))
    torch.testing.assert_close(moon, earth / 6)


def test_the_torch_backend_is_differentiable_in_pose_shape_and_material(body: BodyModel) -> None:
    groom, stiffness = tiny_groom(body).select(torch.arange(4)), torch.tensor(2e-7, requires_grad=True)
    pose, shape = torch.zeros(1, 81, requires_grad=True), torch.zeros(1, 10, requires_grad=True)
    scene = Scene(groom, BodyBatch(body, pose, shape))
    material = replace(HairMaterial(), k_cosserat=stiffness)
    draped = scene.posed.detach() + 0.01 * torch.linspace(0, 1, 24)[:, None]
    total = HairEnergy(groom, material, backend=Backend.TORCH).without("self_collision").total(draped, scene)
    for gradient in torch.autograd.grad(total.sum(), (pose, shape), retain_graph=True):
        assert gradient.abs().max() > 0
        assert gradient.isfinite().all()
    bending = HairEnergy(groom, backend=Backend.TORCH).by_term(draped, scene)["stretch_shear"]
    (slope,) = torch.autograd.grad(total.sum(), stiffness)
    torch.testing.assert_close(slope, bending.sum() / 2e-7, rtol=1e-4, atol=0)
    with pytest.raises(ValueError, match=r"Backend\.TORCH"):
        HairEnergy(groom).total(draped, scene)


def test_parts_of_an_energy_add_up_and_names_are_unique() -> None:
    groom = sphere_groom(strands=5)
    scene, (positions, _) = posed_scene(groom), bent_inwards(groom, batch=1)
    energy = HairEnergy(groom, terms=(*hair_terms(), SPRING))
    parts = (energy.only("point_spring", "stretch"), energy.without("point_spring", "stretch"))
    assert [len(part.terms) for part in (*parts, energy)] == [2, 4, 6]
    sums = sum(part.total(positions, scene) for part in parts)
    torch.testing.assert_close(sums, energy.total(positions, scene), rtol=1e-5, atol=0)
    assert energy.only().total(positions, scene).tolist() == [0.0]
    for part in (energy.only, energy.without):
        with pytest.raises(InputError, match=r"stretch, .*found strech"):
            part("strech")
    with pytest.raises(InputError, match="names that differ"):
        HairEnergy(groom, terms=(SPRING, SPRING))
