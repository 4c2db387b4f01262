"""The elastic model `rod` in solvers: hair at rest keeps its design, and hangs on a body that bows."""

from dataclasses import replace

import pytest
import torch

from quaffure import HairMaterial, InputError
from quaffure.backend import Backend
from quaffure.body import BodyModel, bundled_clip
from quaffure.energies import HairEnergy, RodRest, hair_terms, sag_free_rest, stress_free_rest
from quaffure.hair import Groom
from quaffure.procedural import make_groom
from quaffure.scene import BodyBatch, PosedScene, Scene
from quaffure.solvers import LbfgsDraper, StrandNewtonDraper
from quaffure.types import Float, Positions, Tensor
from tests.scenes import few_strands, upright_scene


def _from_vertical(positions: Tensor) -> Float[Tensor, "b s e"]:
    """Angle of every edge to straight down [deg]."""
    direction = torch.nn.functional.normalize(positions.diff(dim=2), dim=-1)
    return torch.rad2deg(torch.acos((-direction[..., 2]).clamp(-1, 1)))


@pytest.mark.slow
def test_hair_settles_where_it_was_designed(body: BodyModel) -> None:
    groom = few_strands(body, count=200)
    scene = upright_scene(groom, body)
    draped = LbfgsDraper(terms=hair_terms("rod", sag_free_rest(groom, body))).drape(scene)
    distance = (draped - scene.posed).norm(dim=-1)
    assert float(distance.mean()) < 1e-3
    assert float(distance[..., -1].mean()) < 2e-3


@pytest.mark.slow
def test_long_hair_hangs_on_a_body_that_bows(body: BodyModel) -> None:
    groom = few_strands(body, count=60)
    body_pose = bundled_clip("bow", body).body_pose[60:61]
    scene = Scene(groom, BodyBatch(body, body_pose, torch.zeros(1, 10)))
    rod = hair_terms("rod", sag_free_rest(groom, body))
    drapers = StrandNewtonDraper(terms=rod), LbfgsDraper(evaluations=600, terms=hair_terms())
    hanging, paper = (float(_from_vertical(draper.drape(scene))[..., 12:].median()) for draper in drapers)
    assert hanging < 30
    assert paper > 50


@pytest.mark.slow
@pytest.mark.parametrize("style", ["ponytail", "low_bun"])
def test_ties_hold_on_a_body_that_bows(style: str, body: BodyModel) -> None:
    groom = make_groom(style, body)
    groom = groom.select(torch.arange(0, len(groom), 50))
    scene = Scene(groom, BodyBatch(body, bundled_clip("bow", body).body_pose[60:61], torch.zeros(1, 10)))
    held = torch.nn.functional.pad(groom.held_edges, (1, 0))
    moved = []
    for edges in (groom.held_edges, torch.zeros_like(groom.held_edges)):
        design = sag_free_rest(groom, body, held=edges)
        draped = LbfgsDraper(evaluations=400, terms=hair_terms("rod", design)).drape(scene)
        moved.append(float((draped - scene.posed).norm(dim=-1)[0][held].mean()))
    assert moved[0] < 5e-3
    assert moved[1] > 10 * moved[0]


def test_compiled_rod_keeps_the_design_and_its_margins(body: BodyModel) -> None:
    groom = few_strands(body, count=30)
    design = sag_free_rest(groom, body)
    scene = upright_scene(groom, body)
    energy = HairEnergy(groom, terms=hair_terms("rod", design))
    torch.testing.assert_close(energy.rest.collision_margin, design.collision_margin.float())
    assert not bool(design.unstable.any())
    with pytest.raises(InputError, match="groom that it was made for"):
        HairEnergy(groom.select(torch.arange(5)), terms=hair_terms("rod", design))
    with pytest.raises(InputError, match="the elastic model rod"):
        hair_terms("cosserat", design)
    shape = tuple(groom.rest_lengths.shape)
    HairEnergy(groom, terms=hair_terms("rod", design, torch.full(shape, 2.0)))
    with pytest.raises(
        InputError, match=r"stiffness: expected a number or one of each edge, \(\d+, 23\), found \(1, 23\)"
    ):
        HairEnergy(groom, terms=hair_terms("rod", design, torch.ones(1, 23)))
    turned = scene.posed.mean(dim=1, keepdim=True) - scene.posed  # a half turn and a reflection: not rigid
    assert float(energy.only("elastic").total(turned, scene)) > float(energy.only("elastic").total(scene.posed, scene))


def test_stress_free_hair_is_as_stiff_and_as_held_as_the_groom_asks(body: BodyModel) -> None:
    groom = few_strands(body, count=30)
    scene = upright_scene(groom, body)
    asked = torch.zeros_like(groom.rest_lengths)
    asked[:, :3] = 1e-5
    turned = scene.posed[:, :, :1] + 1.2 * (scene.posed - scene.posed[:, :, :1]) @ torch.diag(
        torch.tensor([1.0, -1, 1])
    )

    def energy(changed: Groom) -> float:
        of_rod = HairEnergy(changed, terms=hair_terms("rod")).only("elastic")
        return float(of_rod.total(turned, Scene(changed, scene.bodies)))

    direction = torch.nn.functional.normalize(turned.diff(dim=2), dim=-1)
    held = 0.5 * float((1e-5 * (direction - scene.director)[:, :, :3].square().sum(-1)).sum())
    free = energy(groom)
    assert held > 0.01 * free
    assert energy(replace(groom, goal_weight=asked)) == pytest.approx(free + held, rel=1e-4)
    assert energy(replace(groom, stiffness_scale=torch.full_like(asked, 3.0))) == pytest.approx(3 * free, rel=1e-4)
    tied = replace(groom, tie_vertex=torch.full((len(groom),), 3))
    assert energy(tied) > 2 * free


def _bent(scene: Scene) -> Positions:
    return scene.posed + 0.01 * torch.randn(scene.posed.shape, generator=torch.Generator().manual_seed(0))


def test_a_stiffness_that_changes_in_place_counts(body: BodyModel) -> None:
    groom = few_strands(body, count=5)
    scene = upright_scene(groom, body)
    stiffness = torch.ones_like(groom.rest_lengths)
    energy = HairEnergy(groom, terms=hair_terms("rod", stiffness=stiffness)).only("elastic")
    soft = energy.total(_bent(scene), scene)
    stiffness.mul_(3)
    torch.testing.assert_close(energy.total(_bent(scene), scene), 3 * soft)


def test_every_gradient_by_the_stiffness_is_computed_or_refused(body: BodyModel) -> None:
    groom = few_strands(body, count=5)
    scene = upright_scene(groom, body)
    stiffness = torch.ones_like(groom.rest_lengths).requires_grad_()
    terms = hair_terms("rod", stiffness=stiffness)
    energy = HairEnergy(groom, terms=terms, backend=Backend.TORCH)
    energy.by_term(_bent(scene), scene)
    for times in (1, 2):
        energy.total(_bent(scene), scene).sum().backward()
        assert stiffness.grad is not None
        own = float(energy.by_term(_bent(scene), scene)["elastic"])
        assert float((stiffness.grad * stiffness.detach()).sum()) == pytest.approx(times * own, rel=1e-4)
    compiled = HairEnergy(groom, terms=terms)
    assert float(compiled.by_term(_bent(scene), scene)["elastic"]) == pytest.approx(own, rel=1e-4)
    with pytest.raises(ValueError, match="expected stiffness without gradient"):
        compiled.total(_bent(scene), scene)


def test_a_gradient_by_the_pose_is_computed_or_refused(body: BodyModel) -> None:
    groom, pose = few_strands(body, count=5), torch.zeros(1, 81, requires_grad=True)
    energy = HairEnergy(groom, terms=hair_terms("rod"), backend=Backend.TORCH).without("body_collision")
    scene = Scene(groom, BodyBatch(body, pose, torch.zeros(1, 10)))
    hair = _bent(scene).detach()
    energy.total(hair, scene).sum().backward()
    assert pose.grad is not None
    assert float(pose.grad.abs().max()) > 0
    with pytest.raises(ValueError, match="expected a body without gradient"):
        HairEnergy(groom, terms=hair_terms("rod")).only("elastic").total(hair, scene)
    scene = Scene(groom, BodyBatch(body, pose, torch.zeros(1, 10)))
    energy.by_term(hair, scene)
    with pytest.raises(ValueError, match="expected a scene posed with gradient"):
        energy.total(hair, scene)


def test_hair_without_a_skin_keeps_its_design_by_itself(body: BodyModel) -> None:
    groom, material = few_strands(body, count=5), HairMaterial(k_body_collision=0.0)
    design = sag_free_rest(groom, body, material)
    assert not bool(design.support.any())
    scene = upright_scene(groom, body)
    energy = HairEnergy(groom, material, hair_terms("rod", design))
    assert bool(torch.isfinite(energy.total(scene.posed, scene)).all())
    assert bool(torch.isfinite(design.collision_margin).all())


def test_rotation_of_posed_strands_is_found_from_their_shape(body: BodyModel) -> None:
    groom = few_strands(body, count=30)
    pose = torch.zeros(1, 81)
    pose[0, ::3] = 0.1
    scene = Scene(groom, BodyBatch(body, pose, torch.zeros(1, 10)))
    fitted = PosedScene(groom, scene.posed, scene.surface)
    free = HairEnergy(groom, terms=hair_terms("rod")).only("elastic")
    moved = scene.posed + 0.01 * torch.randn(scene.posed.shape, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(free.total(moved, fitted), free.total(moved, scene), rtol=1e-3, atol=0)


def test_the_rest_shape_of_a_groom_is_computed_once_for_all_scenes(
    body: BodyModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    groom = few_strands(body, count=5)
    made: list[RodRest] = []

    def counted(strands: Tensor, scale: Tensor | None, goal_weight: Tensor | None) -> RodRest:
        made.append(stress_free_rest(strands, scale, goal_weight=goal_weight))
        return made[-1]

    monkeypatch.setattr("quaffure.energies.rod.stress_free_rest", counted)
    energy = HairEnergy(groom, terms=hair_terms("rod"))
    for part in (energy, energy.without("self_collision")):
        for scene in (upright_scene(groom, body), upright_scene(groom, body)):
            part.total(scene.posed, scene)
    assert len(made) == 1


def test_strands_that_fold_back_are_refused() -> None:
    strand = torch.tensor([[[0.0, 0, 0], [0, 0, 0.01], [0, 0, 0.02], [0, 1e-6, 0.01]]], dtype=torch.float64)
    with pytest.raises(InputError, match=r"179\.6 degrees.*strand 0 at vertex 2"):
        stress_free_rest(strand)
