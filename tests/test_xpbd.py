"""XPBD against closed forms, force balances and Adam."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial import ConvexHull

from benchmarks.rods.closed_form import equilibrium_edges
from quaffure import HairMaterial
from quaffure.backend import Backend
from quaffure.body import BodyModel
from quaffure.config import STANDARD_GRAVITY
from quaffure.energies import Cohesion, HairEnergy, hair_terms, terms_of_design
from quaffure.energies.by_name import ROD
from quaffure.energies.cohesion import tails_of
from quaffure.geometry import Surface, posed_surface, surface_topology
from quaffure.geometry.polyline import edges
from quaffure.hair import Groom
from quaffure.scene import PosedScene
from quaffure.solvers import AdamDraper, LbfgsDraper, StrandNewtonDraper, XpbdDraper, XpbdSetting, energy_and_gradient
from quaffure.solvers.xpbd import paper_setting
from tests.scenes import clip_scene, few_strands, posed_scene, sphere_groom

SOFT = HairMaterial(k_cosserat=5e-8)
"""Strands of 10 cm sag a good deal."""
FREE = replace(SOFT, k_body_collision=0.0, k_self_collision=0.0)
LONG_STEPS = XpbdSetting(steps=40, iterations=200, first_time_step=0.5, last_time_step=0.01, refresh=200)


SETTLED = XpbdSetting(steps=200, iterations=50, first_time_step=0.1, last_time_step=0.002, refresh=10)


def box_surface() -> Surface:
    """A box whose upper side is the plane z = 0."""
    corners = np.array(list(itertools.product((-0.3, 0.3), (-0.3, 0.3), (-0.6, 0.0))))
    faces = ConvexHull(corners).simplices.astype(np.int64)
    normals = np.cross(corners[faces[:, 1]] - corners[faces[:, 0]], corners[faces[:, 2]] - corners[faces[:, 0]])
    inwards = (normals * (corners[faces[:, 0]] - [0, 0, -0.3])).sum(1) < 0
    faces[inwards] = faces[inwards][:, ::-1]
    vertices = torch.tensor(corners, dtype=torch.float32)
    return posed_surface(surface_topology(vertices, torch.from_numpy(faces)), vertices[None])


def strands_by_hand(rest: torch.Tensor) -> Groom:
    count = len(rest)
    return Groom(
        name="by_hand",
        rest_strands=rest,
        root_faces=torch.zeros(count, dtype=torch.long),
        root_barycentric=torch.full((count, 3), 1 / 3),
        root_uv=torch.rand(count, 2, generator=torch.Generator().manual_seed(1)),
    )


def gradients(draped: torch.Tensor, scene: PosedScene, energy: HairEnergy) -> tuple[torch.Tensor, torch.Tensor]:
    """Gradient of the whole energy and of Eqs. 10 and 11 alone [N], roots left out."""
    twin = HairEnergy(scene.groom, energy.material, backend=Backend.TORCH)
    contact = twin.only("body_collision", "self_collision")
    whole, of_contact = (energy_and_gradient(part, scene, draped)[1] for part in (twin, contact))
    return whole[:, :, 1:], of_contact[:, :, 1:]


def test_free_strands_hang_in_the_closed_form() -> None:
    groom = sphere_groom(strands=13)
    scene = posed_scene(groom, groom.rest_strands.expand(2, -1, -1, -1))
    draper = XpbdDraper(FREE, LONG_STEPS)
    draped, report = draper.solve(scene)
    rest = HairEnergy(groom, FREE).rest
    exact = equilibrium_edges(scene.director, rest.rest_length, rest.mass_beyond, FREE.k_cosserat, FREE.k_stretch)
    distance = (draped[:, :, 1:] - draped[:, :, :1] - exact.cumsum(2)).norm(dim=-1)
    moved = (scene.posed - draped).norm(dim=-1)
    assert moved.max() > 0.1
    assert distance.max() < 1e-4
    assert (edges(draped).norm(dim=-1) - exact.norm(dim=-1)).abs().max() < 2e-5
    assert report.iterations == 8000
    assert report.relative_gradient < 0.1


def test_masses_and_time_steps_do_not_change_where_hair_comes_to_rest() -> None:
    groom = sphere_groom(strands=5, vertices=10)
    short = XpbdSetting(steps=1500, iterations=10, first_time_step=0.05, last_time_step=0.05, refresh=10)
    ends = [XpbdDraper(FREE, setting).drape(posed_scene(groom)) for setting in (LONG_STEPS, short)]
    assert (ends[0] - ends[1]).norm(dim=-1).max() < 2e-4


def test_a_vertex_rests_on_a_plane_at_its_analytic_penetration() -> None:
    groom = strands_by_hand(torch.tensor([[[0.0, 0.0, 0.0], [0.02, 0.0, 0.004]]]))
    # Hardly any elasticity: gravity against Eq. 10 alone.
    material = HairMaterial(k_cosserat=1e-12, k_stretch=1e-6, k_self_collision=0.0)
    scene = posed_scene(groom, surface=box_surface())
    draped, _ = XpbdDraper(material, XpbdSetting(steps=60, first_time_step=0.02)).solve(scene)
    rest = HairEnergy(groom, material).rest
    penetration = (STANDARD_GRAVITY * float(rest.mass[0, 1]) / (3 * material.k_body_collision)) ** 0.5
    assert 1e-4 < penetration < 2e-4
    assert draped[0, 0, 1, 2].item() == pytest.approx(material.collision_margin - penetration, abs=1e-6)


def test_forces_of_a_strand_that_lies_on_a_sphere_balance() -> None:
    groom = sphere_groom(strands=8)
    material = replace(SOFT, k_self_collision=0.0)
    scene = posed_scene(groom)
    energy = HairEnergy(groom, material)
    draped, report = XpbdDraper(material, SETTLED).solve(scene)
    whole, contact = gradients(draped, scene, energy)
    assert contact.norm() > STANDARD_GRAVITY * energy.rest.mass.mean()
    assert whole.norm() < 0.04 * contact.norm()
    assert report.relative_gradient < 0.2


def test_two_strands_press_each_other_apart_until_forces_balance() -> None:
    drop = torch.linspace(0, 0.05, 8)[:, None] * torch.tensor([0.0, 0.0, -1.0])
    rest = torch.stack([drop + torch.tensor([side, 0.0, 0.5]) for side in (-0.005, 0.005)])
    groom = strands_by_hand(rest)
    posed = rest.clone()
    posed[..., 0] *= 0.2
    material = HairMaterial(k_self_collision=1e-4)
    scene = posed_scene(groom, posed[None])
    draped, _ = XpbdDraper(material, SETTLED).solve(scene)
    whole, contact = gradients(draped, scene, HairEnergy(groom, material))
    assert (draped[0, 1, -1, 0] - draped[0, 0, -1, 0]) > 0.003
    assert contact.norm() > 1e-7
    assert whole.norm() < 0.02 * contact.norm()


def test_long_time_steps_do_not_throw_pressed_hair_through_its_neighbours() -> None:
    """Unless a pass over the densities moves hair by less than the kernel is wide, Eq. 11 never settles."""
    generator = torch.Generator().manual_seed(0)
    drop = torch.linspace(0, 0.1, 12)[:, None] * torch.tensor([0.0, 0.0, -1.0])
    spread = 0.02 * torch.rand(60, 1, 3, generator=generator)
    groom = strands_by_hand(drop + spread + torch.tensor([0.0, 0.0, 0.5]))
    posed = groom.rest_strands[None].clone()
    posed[:, :, 1:, :2] = 0.005 + 0.5 * posed[:, :, 1:, :2]
    scene = posed_scene(groom, posed)
    energy = HairEnergy(groom, HairMaterial(k_self_collision=1e-5))
    setting = XpbdSetting(steps=8, iterations=200, first_time_step=0.05, last_time_step=0.05, relaxation=1.0)
    draped, _ = XpbdDraper(energy.material, setting).solve(scene)
    before, after = (float(energy.per_vertex(energy.by_term(x, scene)["self_collision"])) for x in (posed, draped))
    assert before > 0.1
    assert after < 1e-3 * before


def test_deep_hair_comes_out_of_the_body() -> None:
    groom = sphere_groom(strands=40)
    posed = groom.rest_strands[None].clone()
    posed[:, :, 1:] = posed[:, :, :1] + 0.5 * (posed[:, :, :1] - posed[:, :, 1:])
    assert (posed[:, :, 5:12].norm(dim=-1) < 0.085).all()
    draped = XpbdDraper().drape(posed_scene(groom, posed))
    assert torch.isfinite(draped).all()
    assert (draped[:, :, 1:].norm(dim=-1) < 0.097).float().mean() < 0.02


def test_it_descends_holds_the_roots_and_reaches_the_energy_of_adam() -> None:
    groom = sphere_groom(strands=43)
    scene = posed_scene(groom, groom.rest_strands.expand(2, -1, -1, -1))
    energy = HairEnergy(groom)
    at_start = float(energy_and_gradient(energy, scene, scene.posed)[0].mean())
    draped, report = XpbdDraper().solve(scene)
    adam = AdamDraper(steps=400).solve(scene)[1].energy
    assert torch.equal(draped[:, :, 0], scene.posed[:, :, 0])
    assert torch.equal(draped[0], draped[1])
    assert report.energy < at_start
    assert report.energy < adam + 0.03 * (at_start - adam)


def test_the_setting_of_the_paper() -> None:
    setting = paper_setting()
    assert (setting.steps, setting.iterations) == (30, 10_000)
    assert setting.time_step(0) == setting.time_step(29) == setting.first_time_step


# --- the rod ---------------------------------------------------------------------------------------------------------


def test_the_rod_settles_where_lbfgs_settles_it() -> None:
    groom = sphere_groom(strands=7, vertices=16)
    scene, terms = posed_scene(groom), hair_terms(ROD)
    material = HairMaterial(k_self_collision=0.0)
    draped = XpbdDraper(material, SETTLED, terms).drape(scene)
    lowest = LbfgsDraper(material, terms=terms).drape(scene)
    energy = HairEnergy(groom, material, terms)
    begun, ended, expected = (float(energy.per_vertex(energy.total(x, scene))) for x in (scene.posed, draped, lowest))
    assert begun > expected + 0.05
    assert abs(ended - expected) < 5e-4
    assert (draped - lowest).norm(dim=-1).mean() < 5e-4


def test_very_short_edges_keep_their_length_with_the_rod() -> None:
    groom = sphere_groom(strands=3, vertices=24)
    rest = groom.rest_strands
    short = replace(groom, rest_strands=rest[:, :1] + 0.1 * (rest - rest[:, :1]))
    draped = XpbdDraper(HairMaterial(), SETTLED, hair_terms(ROD)).drape(posed_scene(short))
    length = draped.diff(dim=2).norm(dim=-1)
    assert short.rest_lengths.max() < 1e-3
    assert (length / short.rest_lengths - 1).abs().max() < 1e-3


@pytest.mark.slow
def test_a_tail_settles_as_low_as_newtons_method_leaves_it(body: BodyModel) -> None:
    groom = few_strands(body, "ponytail")
    scene = clip_scene(groom, body, "neck_turn", slice(36, 37))
    terms = terms_of_design(groom, body, HairMaterial())
    energy = HairEnergy(groom, terms=terms)
    by_xpbd, by_newton = (draper.drape(scene) for draper in (XpbdDraper(terms=terms), StrandNewtonDraper(terms=terms)))
    ended, expected = (float(energy.per_vertex(energy.total(x, scene))) for x in (by_xpbd, by_newton))
    assert ended < expected + 0.005


def test_cohesion_draws_strands_together() -> None:
    """Two strands whose tie lets them part hang closer to their centre line with the term than without it."""
    length = torch.linspace(0, 0.1, 12)[:, None]
    rest = torch.stack([length * torch.tensor([0.5, sideways, -0.6]) for sideways in (-0.4, 0.4)])
    groom = replace(strands_by_hand(rest), tie_vertex=torch.ones(2, dtype=torch.int16))
    scene, material = posed_scene(groom), HairMaterial(k_self_collision=0.0, k_body_collision=0.0)
    tails = tails_of(groom)
    assert tails is not None
    near = tails._replace(rest_distance=torch.zeros_like(tails.rest_distance))
    apart, together = (
        XpbdDraper(material, SETTLED, (*hair_terms(ROD), *terms)).drape(scene)
        for terms in ((), (Cohesion(near, swelling=0.0, slack=0.0),))
    )
    expected = LbfgsDraper(material, terms=(*hair_terms(ROD), Cohesion(near, swelling=0.0, slack=0.0))).drape(scene)
    distance = [near.from_centre(x).norm(dim=-1).mean() for x in (apart, together, expected)]
    assert distance[1] < 0.9 * distance[0]
    assert abs(distance[1] - distance[2]) < 0.02 * distance[2]
