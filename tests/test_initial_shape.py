"""The strands before the network: rods in equilibrium without contact, with the support that still points up."""

from dataclasses import replace

import pytest
import torch

from quaffure import HairMaterial
from quaffure.body import BodyModel, head_frame_body_reference
from quaffure.config import STANDARD_GRAVITY
from quaffure.energies import STANDARD_LOADING, HairEnergy, Loading, design_of, hair_terms
from quaffure.geometry import matrix_from_axis_angle
from quaffure.hair import Groom, triangle_frames
from quaffure.model import InitialShapeConfig, NetworkConfig, PreparedGroom, load_groom_encoder, prepare_groom
from quaffure.model.free_rod import FreeRods, free_rod_directions
from quaffure.model.initial_shape import initial_shape_reference
from quaffure.procedural import make_groom
from quaffure.scene import BodyBatch, Scene
from quaffure.solvers import StrandDescent
from quaffure.types import Tensor

MATERIAL = HairMaterial()
FREE = NetworkConfig(contact=False)


@pytest.fixture(scope="module")
def groom(body: BodyModel) -> Groom:
    return make_groom("long_wavy", body).select(torch.arange(0, 2400, 60))


@pytest.fixture(scope="module")
def prepared(groom: Groom, body: BodyModel) -> PreparedGroom:
    return prepare_groom(groom, body, load_groom_encoder(), FREE, MATERIAL)


def turned_bodies(body: BodyModel, x: float) -> BodyBatch:
    """The body turned as a whole by `x` [rad], its head first."""
    pose = torch.zeros(1, 81)
    pose[0, 0] = x
    return BodyBatch(body, pose, torch.zeros(1, 10))


def edges(prepared: PreparedGroom, bodies: BodyBatch, loading: Loading = STANDARD_LOADING, passes: int = 2) -> Tensor:
    """In the head's frame."""
    config = InitialShapeConfig(passes=passes)
    view = head_frame_body_reference(bodies.body, bodies.body_pose, bodies.body_shape, bodies.posed, config.body)
    return initial_shape_reference(prepared, view, loading, config).edges[0]


def rods(count: int, length: float = 0.01) -> FreeRods:
    """One straight, horizontal strand without support, as light as hair."""
    direction = torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64).repeat(1, 1, count, 1)
    force = torch.tensor([0.0, 0.0, -length], dtype=torch.float64).repeat(1, 1, count, 1)
    bending = torch.full((1, 1, count), 8e-9 / (6.5e-6 * STANDARD_GRAVITY) / length, dtype=torch.float64)
    zero = torch.zeros(1, 1, count, 3, dtype=torch.float64)
    return FreeRods(direction, zero, force, bending, torch.zeros_like(bending), torch.full_like(bending, length))


def test_upright_the_design_is_at_rest(prepared: PreparedGroom, groom: Groom, body: BodyModel) -> None:
    found = edges(prepared, turned_bodies(body, 0.0), passes=6)
    torch.testing.assert_close(
        found, torch.nn.functional.normalize(groom.rest_strands.diff(dim=1), dim=-1), atol=2e-5, rtol=0
    )


def test_without_its_support_hair_falls(prepared: PreparedGroom, groom: Groom, body: BodyModel) -> None:
    bare = replace(prepared, rods=prepared.rods._replace(support=torch.zeros_like(prepared.rods.support)))
    moved = (edges(bare, turned_bodies(body, 0.0)) - edges(prepared, turned_bodies(body, 0.0))).norm(dim=-1)
    assert moved.max() > 0.1


def test_upside_down_support_that_pointed_up_is_gone(prepared: PreparedGroom, groom: Groom, body: BodyModel) -> None:
    frames = triangle_frames(body.rest_vertices[body.faces[groom.root_faces]])
    up = (frames.mT @ torch.tensor([0.0, 0.0, 1.0]))[:, None]
    strength = prepared.rods.support.norm(dim=-1, keepdim=True)
    upward = prepared.rods._replace(support=strength * up, upness=torch.full_like(prepared.rods.upness, 2.0))
    bare = upward._replace(support=torch.zeros_like(upward.support))
    for tilt, most, least in ((torch.pi, 2e-3, 0.0), (0.0, torch.inf, 0.1)):
        found = [edges(replace(prepared, rods=rods), turned_bodies(body, tilt)) for rods in (upward, bare)]
        assert least <= (found[0] - found[1]).norm(dim=-1).max() <= most


def test_a_free_rod_ends_where_the_energy_of_the_rod_is_lowest(groom: Groom, body: BodyModel) -> None:
    """Straight hair without support, on a head that is tilted: the minimum of `HairEnergy` without contact."""
    straight = make_groom("long_straight", body).select(torch.arange(0, 2400, 120))
    bodies = turned_bodies(body, 0.6)
    prepared = prepare_groom(straight, body, load_groom_encoder(), FREE, MATERIAL)
    prepared = replace(prepared, rods=prepared.rods._replace(support=torch.zeros_like(prepared.rods.support)))
    found = edges(prepared, bodies, passes=8)
    scene = Scene(straight, bodies)
    design = design_of(straight, body, MATERIAL)
    energy = HairEnergy(straight, MATERIAL, hair_terms("rod", design))
    descent = StrandDescent(energy, scene.sample(0))
    descent.run_free(12)
    head = bodies.posed.joint_rotations[0, body.joint_names.index("Head")]
    expected = torch.from_numpy(descent.direction) @ head
    apart = torch.rad2deg((found * expected).sum(-1).clamp(-1, 1).arccos())
    assert apart.median() < 3
    posed = torch.nn.functional.normalize(straight.rest_strands.diff(dim=1), dim=-1)
    assert torch.rad2deg((posed * expected).sum(-1).clamp(-1, 1).arccos()).median() > 15


def test_passes_converge_to_balanced_moments() -> None:
    strand = rods(23)
    direction = free_rod_directions(strand, 20)
    weight = strand.force.flip(2).cumsum(2).flip(2)
    torque = strand.length[..., None] * torch.linalg.cross(direction, weight)
    before = torch.cat([strand.direction[:, :, :1], direction[:, :, :-1]], dim=2)
    turned = torch.linalg.cross(before, direction)  # sine of the angle between edges
    sine = turned.norm(dim=-1, keepdim=True)
    half = 2 * torch.sin(torch.asin(sine) / 2) * turned / sine.clamp(min=1e-12)
    moment = strand.bending[..., None] * half
    left = moment - torch.nn.functional.pad(moment[:, :, 1:], (0, 0, 0, 1)) - torque
    assert left.norm(dim=-1).max() < 1e-6 * torque.norm(dim=-1).max()


def test_two_passes_are_near_the_end() -> None:
    strand = rods(23)
    tips = [(0.01 * free_rod_directions(strand, passes)).sum(2)[0, 0] for passes in (0, 1, 2, 30)]
    apart = [float((tip - tips[-1]).norm()) for tip in tips]
    assert apart[0] > 0.15
    assert apart[1] < 0.06
    assert apart[2] < 0.02


def test_stiffer_hair_bends_less_and_heavier_more() -> None:
    strand = rods(10)
    drop = [
        float(
            (0.01 * free_rod_directions(strand._replace(bending=b * strand.bending, force=f * strand.force), 8)).sum(2)[
                0, 0, 2
            ]
        )
        for b, f in ((1, 1), (3, 1), (1, 2))
    ]
    assert drop[2] < drop[0] < drop[1] < 0


def test_held_edges_stay() -> None:
    strand = rods(10)
    goal = strand.goal.clone()
    goal[..., :4] = 200 * strand.bending[..., :4]
    held = free_rod_directions(strand._replace(goal=goal), 4)
    assert torch.rad2deg((held[:, :, :4] * strand.direction[:, :, :4]).sum(-1).clamp(-1, 1).arccos()).max() < 2
    assert held[0, 0, -1, 2] < -0.1


def test_acceleration_acts_in_the_world(prepared: PreparedGroom, body: BodyModel) -> None:
    """A body on its back under gravity hangs as one that stands in wind from the front as strong as gravity."""
    lying = turned_bodies(body, -torch.pi / 2)
    rotation = matrix_from_axis_angle(lying.body_pose[0, :3])
    pull = torch.tensor([0.0, 0.0, -STANDARD_GRAVITY]) @ rotation
    x, y, z = pull.tolist()
    torch.testing.assert_close(
        edges(prepared, lying), edges(prepared, turned_bodies(body, 0.0), Loading(1.0, (x, y, z))), atol=2e-3, rtol=0
    )


@pytest.mark.slow
def test_a_start_is_smooth_in_the_pose(prepared: PreparedGroom, body: BodyModel) -> None:
    """Differences over half a step are half as large: no strand jumps."""
    angles = torch.linspace(0.2, 1.4, 25)
    found = torch.stack([edges(prepared, turned_bodies(body, float(angle))) for angle in angles])
    step = found.diff(dim=0).norm(dim=-1)
    assert step.max() < 0.35
