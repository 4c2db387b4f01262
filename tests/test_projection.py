"""Strands pushed out of the skin: the kernel against its torch twin, and what must hold of both."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from quaffure.backend import Backend
from quaffure.body import BodyModel
from quaffure.body.collision_skin import collision_skin
from quaffure.energies import HairEnergy, terms_of_design
from quaffure.energies.rest_state import rest_state
from quaffure.geometry.rotation_kernel import lifted_edge
from quaffure.geometry.signed_distance import signed_distance
from quaffure.model import (
    InitialShapeConfig,
    NetworkConfig,
    NeuralDraper,
    PreparedGroom,
    ProjectionConfig,
    build_network,
    load_model,
    prepare_groom,
    project,
)
from quaffure.model.bend_relaxation import bends
from quaffure.model.neural import drape
from quaffure.model.prepared_groom import raised_before_supports
from quaffure.model.projection import project_reference, push_settings
from quaffure.model.projection_kernel import PushedRods, PushSettings
from quaffure.procedural import make_groom
from quaffure.scene import BodyBatch, Scene
from quaffure.types import Positions
from tests.scenes import random_bodies


@pytest.fixture(scope="module")
def bodies(body: BodyModel) -> BodyBatch:
    return random_bodies(body, 2)


@pytest.fixture(scope="module")
def scene(bodies: BodyBatch) -> Scene:
    return Scene(make_groom("long_straight", bodies.body).select(torch.arange(0, 2400, 31)), bodies)


@pytest.fixture(scope="module")
def prepared(scene: Scene) -> PreparedGroom:
    return prepared_with(scene)


CONFIG = ProjectionConfig()
SETTINGS = push_settings(CONFIG, 1.0)
ONCE = SETTINGS._replace(pushes=1, contact_stiffness=np.float32(0.0))
ONE_PUSH = push_settings(ProjectionConfig(pushes=1, push_relaxation=0.0), 1.0)


def prepared_with(scene: Scene) -> PreparedGroom:
    """Strands that are kept at half of their collision margins."""
    draper, groom = load_model().draper, scene.groom
    margin = rest_state(groom.rest_strands, draper.material).collision_margin
    return replace(draper.prepared(groom, scene.bodies.body), clearance=CONFIG.clearance_share * margin)


def projected(
    strands: Positions, groom: PreparedGroom, bodies: BodyBatch, settings: PushSettings = SETTINGS
) -> Positions:
    return pushed_out(strands, groom.blocks.pushed, bodies, settings)


def pushed_out(strands: Positions, rods: PushedRods, bodies: BodyBatch, settings: PushSettings = SETTINGS) -> Positions:
    skin, head = collision_skin(bodies.body, float(rods.clearance.max())), bodies.body.joint_names.index("Head")
    posed = zip(strands, bodies.posed.vertices[:, skin.vertices], bodies.posed.joint_positions[:, head])
    return torch.stack([project(own, skins, rods, skin, centre, settings) for own, skins, centre in posed])


def inside(strands: Positions, scene: Scene) -> torch.Tensor:
    """Share of vertices in the body."""
    return (signed_distance(strands.flatten(1, 2), scene.surface) < 0).float().mean(dim=1)


@pytest.mark.parametrize("stiffness", [1.0, 20.0])
def test_kernel_and_twin_agree(scene: Scene, prepared: PreparedGroom, stiffness: float) -> None:
    settings, skin = push_settings(CONFIG, stiffness), collision_skin(scene.bodies.body)
    found = projected(scene.posed, prepared, scene.bodies, settings)
    assert (found - scene.posed).norm(dim=-1).max() > 0.02  # posed strands run through the shoulders
    for sample in range(2):
        vertices = scene.bodies.posed.vertices[sample, skin.vertices]
        expected = project_reference(scene.posed[sample], vertices, prepared, skin, settings)
        off = (found[sample] - expected).norm(dim=-1)
        # Where two faces are as near as each other, rounding decides on one; what hangs on that edge moves along.
        assert (off < 1e-5).float().mean() > 0.99


def test_very_short_hair_is_that_of_the_twin(bodies: BodyBatch) -> None:
    scene = Scene(make_groom("crew_cut", bodies.body).select(torch.arange(0, 2400, 31)), bodies)
    prepared, skin = prepared_with(scene), collision_skin(bodies.body)
    flat = scene.posed.clone()
    flat[..., 1:, :] -= 0.8 * (flat[..., 1:, :] - flat[..., :1, :])  # most of it is too close to the skin
    flat = flat[..., :1, :] + torch.nn.functional.pad(
        (prepared.rest_length[..., None] * torch.nn.functional.normalize(flat.diff(dim=2), dim=-1)).cumsum(2),
        (0, 0, 1, 0),
    )
    flat[..., 1:, :] -= 0.002 * torch.nn.functional.normalize(
        scene.posed[..., -1:, :] - scene.posed[..., :1, :], dim=-1
    )
    found = projected(flat, prepared, bodies)
    vertices = bodies.posed.vertices[0, skin.vertices]
    expected = project_reference(flat[0], vertices, prepared, skin, SETTINGS)
    assert (found[0] - flat[0]).abs().max() > 1e-4
    assert ((found[0] - expected).norm(dim=-1) < 1e-5).float().mean() > 0.99


def test_hair_leaves_the_body_and_keeps_its_lengths(scene: Scene, prepared: PreparedGroom) -> None:
    out = projected(scene.posed, prepared, scene.bodies)
    before, after = (inside(strands, scene) for strands in (scene.posed, out))
    assert (before > 0.02).all()
    assert (after < 0.3 * before).all()
    torch.testing.assert_close(
        out.diff(dim=2).norm(dim=-1), prepared.rest_length.expand(2, -1, -1), atol=2e-6, rtol=1e-5
    )
    assert torch.equal(out[:, :, 0], scene.posed[:, :, 0])


def test_strands_in_the_open_stay_to_the_bit(scene: Scene, prepared: PreparedGroom) -> None:
    distance = signed_distance(scene.posed.flatten(1, 2), scene.surface).unflatten(1, scene.posed.shape[1:3])
    free = (distance[..., 1:] >= prepared.clearance[:, 1:] + 1e-5).all(dim=-1)
    out = projected(scene.posed, prepared, scene.bodies)
    assert free.sum() > 10
    assert torch.equal(out[free], scene.posed[free])
    assert not torch.equal(out[~free], scene.posed[~free])


def test_what_is_out_of_the_skin_stays(scene: Scene, prepared: PreparedGroom) -> None:
    once = projected(scene.posed, prepared, scene.bodies)
    twice = projected(once, prepared, scene.bodies)
    moved = (twice - once).norm(dim=-1)
    assert moved.mean() < 0.05 * (once - scene.posed).norm(dim=-1).mean()


@pytest.mark.parametrize("views", [True, False])
def test_a_drape_is_the_networks_out_of_the_skin(scene: Scene, views: bool) -> None:
    torch.manual_seed(0)
    # Where hair starts nearer, less of it is pushed out, and rounding makes less of a difference.
    near = InitialShapeConfig(bend_relaxation=0.0, margin_slope=0.6)
    config = NetworkConfig(texel_channels=8, strand_width=16, skin_features=views, initial_shape=near)
    network = build_network(replace(config, projection=ProjectionConfig(clearance_slope=0.5))).eval()
    draper = NeuralDraper(network, load_model().draper.material)
    with torch.no_grad():
        deformed = draper.deform(scene)
    expected = projected(deformed, draper.prepared(scene.groom, scene.bodies.body), scene.bodies)
    assert (expected - deformed).norm(dim=-1).max() > 1e-3
    assert ((draper.drape(scene) - expected).norm(dim=-1) < 1e-5).float().mean() > 0.99


@pytest.mark.parametrize("config", [NetworkConfig(contact=False), NetworkConfig(output="displacement")])
def test_networks_without_the_skin_stay_without_it(scene: Scene, config: NetworkConfig) -> None:
    torch.manual_seed(0)
    draper = NeuralDraper(build_network(config).eval(), load_model().draper.material)
    with torch.no_grad():
        torch.testing.assert_close(draper.drape(scene), draper.deform(scene), atol=1e-5, rtol=0)


def test_relaxed_bends_cost_less(bodies: BodyBatch) -> None:
    """Rods at rest in the shape that they came with: relaxed between pushes, they are bent less at single vertices."""
    scene = Scene(make_groom("slicked_back", bodies.body).select(torch.arange(0, 2400, 31)), bodies)
    prepared = prepared_with(scene)
    free = torch.nn.functional.normalize(scene.posed.diff(dim=2), dim=-1)

    def cost(hair: Positions) -> torch.Tensor:
        edges = torch.nn.functional.normalize(hair.diff(dim=2), dim=-1)
        return (prepared.rods.bending * bends(edges, free).square().sum(-1)).sum((1, 2))

    pushed, relaxed = (projected(scene.posed, prepared, scene.bodies, settings) for settings in (ONE_PUSH, SETTINGS))
    assert cost(relaxed).sum() < 0.7 * cost(pushed).sum()
    outside = [1 - inside(strands, scene) for strands in (pushed, relaxed)]
    assert (outside[1] > outside[0] - 0.002).all()


def test_held_edges_are_not_turned_back(scene: Scene, prepared: PreparedGroom) -> None:
    goal = torch.where(torch.arange(23) < 8, 1e3 * prepared.rods.bending, 0.0)
    held = replace(prepared, rods=prepared.rods._replace(goal=goal))
    found, pushed = (projected(scene.posed, held, scene.bodies, settings) for settings in (ONCE, ONE_PUSH))
    moved = (found - pushed).norm(dim=-1)
    assert moved[..., :9].max() < 0.02 * moved.max()
    skin = collision_skin(scene.bodies.body)
    vertices = scene.bodies.posed.vertices[0, skin.vertices]
    off = (found[0] - project_reference(scene.posed[0], vertices, held, skin, ONCE)).norm(dim=-1)
    assert (off < 1e-5).float().mean() > 0.99


@pytest.mark.parametrize("across", [0.0, 1e-7, 0.3, 1.0])
@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (0.8, 0.0, 0.6), (-0.6, 0.8, 0.0)])
def test_the_end_of_a_lifted_edge_is_higher_by_the_push(across: float, normal: tuple[float, float, float]) -> None:
    """An edge straight into the skin, too, which adding the push to its end would only make shorter."""
    up = np.array(normal, np.float32)
    side = np.cross(up, np.float32([0.36, 0.48, 0.8]))
    side = side / np.linalg.norm(side)
    edge = 0.01 * (across * side - np.sqrt(1 - across**2) * up).astype(np.float32)
    for push, expected in ((0.004, None), (0.5, 0.0095)):
        found = np.array(lifted_edge(tuple(edge), tuple(up), np.float32(push), np.float32(0.01), np.float32(0.95)))
        assert np.linalg.norm(found) == pytest.approx(0.01, rel=1e-5)
        assert found @ up == pytest.approx(edge @ up + push if expected is None else expected, abs=1e-7)


def test_a_strand_alone_is_pushed_as_in_its_groom(scene: Scene, prepared: PreparedGroom) -> None:
    whole = projected(scene.posed, prepared, scene.bodies)
    for strand in range(0, len(scene.groom), 8):
        one = slice(strand, strand + 1)
        rods = PushedRods(*(values[one] for values in prepared.blocks.pushed))
        alone = pushed_out(scene.posed[:, one], rods, scene.bodies)
        torch.testing.assert_close(alone, whole[:, one], atol=1e-6, rtol=0)


def test_the_callers_strands_are_not_changed(scene: Scene, prepared: PreparedGroom) -> None:
    before = scene.posed.clone()
    projected(scene.posed, prepared, scene.bodies)
    assert torch.equal(scene.posed, before)


@pytest.mark.parametrize("wrong", [torch.nan, torch.inf, -torch.inf, 1e30])
def test_what_is_not_finite_stays(scene: Scene, prepared: PreparedGroom, wrong: float) -> None:
    strands = scene.posed.clone()
    strands[0, 3, 5:] = wrong
    found = projected(strands, prepared, scene.bodies)
    torch.testing.assert_close(found[0], strands[0], equal_nan=True, atol=0, rtol=0)
    assert not torch.equal(found[1], strands[1])


def test_a_body_blown_up_ends_in_no_crash(scene: Scene) -> None:
    skin, strands = collision_skin(scene.bodies.body), scene.posed[0]
    vertices, prepared = 1e30 * scene.bodies.posed.vertices[0, skin.vertices], prepared_with(scene)
    assert torch.equal(project(strands, vertices, prepared.blocks.pushed, skin, torch.zeros(3), SETTINGS), strands)


def test_the_shipped_model_leaves_the_skin(scene: Scene) -> None:
    model, bodies = load_model(), scene.bodies
    with torch.no_grad():
        deformed = model.draper.deform(scene)
    drapes = model.drape(scene.groom, bodies.body_pose, bodies.body_shape)
    prepared = model.draper.prepared(scene.groom, model.body)
    expected = projected(deformed, prepared, bodies, push_settings(model.draper.network.config.projection, 1.0))
    assert (expected - deformed).norm(dim=-1).max() > 1e-3
    assert ((drapes - expected).norm(dim=-1) < 5e-4).float().mean() > 0.99  # bfloat16
    many = list(model.drape_many([scene.groom] * 2, bodies.body_pose, bodies.body_shape))
    torch.testing.assert_close(torch.stack(many), drapes, atol=1e-5, rtol=0)


def test_margins_of_five_centimetres_are_kept(scene: Scene) -> None:
    model = load_model(bf16=False).draper
    draper = NeuralDraper(model.network, replace(model.material, collision_margin=0.05))
    clearance = draper.prepared(scene.groom, scene.bodies.body).clearance
    wide = clearance > 0.03
    assert wide.float().mean() > 0.05
    for backend in (None, Backend.TORCH):
        few = Scene(scene.groom.select(torch.arange(0, len(scene.groom), 8)), scene.bodies)
        hair = NeuralDraper(model.network, draper.material, backend=backend).drape(few)
        short = clearance[::8] - signed_distance(hair.flatten(1, 2), few.surface).unflatten(1, hair.shape[1:3])
        assert (short[:, wide[::8]] < 1e-3).float().mean() > 0.95


def test_distances_to_keep_grow_towards_the_vertex_that_needs_most() -> None:
    clearance = torch.tensor([[0.0, 0.003, 0.003, 0.003, 0.020, 0.003]])
    at_rest = torch.tensor([[0.0, 0.004, 0.009, 0.030, 0.024, 0.026]])
    found = raised_before_supports(clearance, torch.full((1, 5), 0.01), at_rest, slope=0.5)
    # 15 mm a centimetre before it; 10 mm another one before, but no more than in the design.
    torch.testing.assert_close(found, torch.tensor([[0.0, 0.004, 0.009, 0.015, 0.020, 0.003]]))


def test_hair_does_not_fold_over_a_shoulder(body: BodyModel) -> None:
    """Where tips are to keep far from the skin, the middles of the strands leave a near shoulder as well.

    Strands that start as far out as their tips are to be leave it by themselves; these start nearer.
    """
    groom, draper = make_groom("bob", body).select(torch.arange(0, 2400, 9)), load_model().draper
    pose = torch.zeros(1, 27, 3)
    for joint, angle in {"Neck": -0.4, "Head": -0.4, "LeftShoulder": -0.5, "RightShoulder": 0.5}.items():
        pose[0, body.joint_names.index(joint), 1] = angle
    scene = Scene(groom, BodyBatch(body, pose.flatten(1), torch.zeros(1, 10)))
    energy = HairEnergy(groom, draper.material, terms_of_design(groom, body, draper.material)).only("body_collision")
    config, contact = draper.network.config, {}
    steep = 1e9
    for slope in (config.projection.clearance_slope, steep):
        near = replace(config.initial_shape, margin_slope=0.6)
        changed = replace(config, initial_shape=near, projection=replace(config.projection, clearance_slope=slope))
        prepared = prepare_groom(groom, body, draper.network.encoder, changed, draper.material)
        with torch.no_grad():
            (hair,) = drape(draper.backend(), [prepared], scene.bodies)
        contact[slope] = float(energy.total(hair, scene))
    assert 0 < contact[config.projection.clearance_slope] < 0.9 * contact[steep]
