import math
from dataclasses import replace

import pytest
import torch

from quaffure.baselines import PosedDraper
from quaffure.body import BodyModel, Motion, PosedBody, load_body
from quaffure.body.pose_features import world_from_head
from quaffure.drape_motion import drape_motion
from quaffure.geometry import matrix_from_axis_angle
from quaffure.hair import Groom, groom_of_drape, posed_strands, root_positions, root_rotations, triangle_frames
from quaffure.hair.posing import ties_of
from quaffure.procedural import HairStyle, make_groom
from quaffure.scene import BodyBatch, Scene


@pytest.fixture(scope="module")
def body() -> BodyModel:
    return load_body()


@pytest.fixture(scope="module")
def groom(body: BodyModel) -> Groom:
    return make_groom(HairStyle(root_rows=16), body)


def random_body(body: BodyModel, batch: int = 2, seed: int = 0) -> PosedBody:
    generator = torch.Generator().manual_seed(seed)
    pose = 0.2 * torch.randn(batch, 81, generator=generator)
    return body.pose(pose, torch.randn(batch, 10, generator=generator))


def test_the_rest_pose_leaves_the_rest_groom(body: BodyModel, groom: Groom) -> None:
    posed = posed_strands(groom, body.pose(torch.zeros(1, 81), torch.zeros(1, 10)), body)
    assert torch.allclose(posed[0], groom.rest_strands, atol=2e-5)


def test_a_turned_body_turns_every_strand_with_it(body: BodyModel, groom: Groom) -> None:
    pose = torch.zeros(1, 81)
    pose[0, :3] = torch.tensor([0.3, -0.5, 1.1])
    rotation = matrix_from_axis_angle(pose[0, :3])
    hips = body.rest_joints[0]
    expected = (groom.rest_strands - hips) @ rotation.T + hips
    assert torch.allclose(posed_strands(groom, body.pose(pose, torch.zeros(1, 10)), body)[0], expected, atol=1e-5)


def test_a_turned_head_takes_its_crown_along_rigidly(body: BodyModel, groom: Groom) -> None:
    joint = body.joint_names.index("Head")
    pose = torch.zeros(1, 81)
    pose[0, 3 * joint : 3 * joint + 3] = torch.tensor([0.0, 0.0, math.radians(50)])
    posed = posed_strands(groom, body.pose(pose, torch.zeros(1, 10)), body)[0]
    rotation = matrix_from_axis_angle(pose[0, 3 * joint : 3 * joint + 3])
    centre = body.rest_joints[joint]
    expected = (groom.rest_strands - centre) @ rotation.T + centre
    # The crown belongs to the head alone; the nape shares its skin with the neck.
    crown = groom.rest_strands[:, 0, 2] > centre[2] + 0.1
    assert crown.sum() > 20
    assert torch.allclose(posed[crown], expected[crown], atol=1e-4)


def test_posing_is_equivariant_to_motions_of_the_world(body: BodyModel, groom: Groom) -> None:
    posed = random_body(body)
    rotation = matrix_from_axis_angle(torch.tensor([0.4, 1.0, -0.7]))
    shift = torch.tensor([0.3, -2.0, 1.0])
    moved = PosedBody(posed.vertices @ rotation.T + shift, rotation @ posed.joint_rotations, posed.joint_positions)
    expected = posed_strands(groom, posed, body) @ rotation.T + shift
    assert torch.allclose(posed_strands(groom, moved, body), expected, atol=1e-5)


def test_every_strand_keeps_its_shape_whatever_pose_and_body(body: BodyModel, groom: Groom) -> None:
    posed = random_body(body, seed=4)
    strands = posed_strands(groom, posed, body)
    between_vertices = torch.cdist(groom.rest_strands, groom.rest_strands)
    assert torch.allclose(torch.cdist(strands[1], strands[1]), between_vertices, atol=2e-4)
    assert torch.allclose(strands.diff(dim=2).norm(dim=-1)[0], groom.rest_lengths, atol=1e-5)


def test_roots_stay_on_their_triangles(body: BodyModel, groom: Groom) -> None:
    posed = random_body(body, seed=5)
    strands = posed_strands(groom, posed, body)
    assert torch.allclose(strands[:, :, 0], root_positions(groom, posed.vertices, body), atol=1e-5)


def test_root_rotations_are_rotations(body: BodyModel, groom: Groom) -> None:
    rotations = root_rotations(groom, random_body(body, seed=6), body)
    assert torch.allclose(rotations @ rotations.mT, torch.eye(3).expand_as(rotations), atol=1e-5)
    assert torch.allclose(torch.linalg.det(rotations), torch.ones(rotations.shape[:2]), atol=1e-5)


@pytest.fixture(scope="module")
def ponytail(body: BodyModel) -> Groom:
    return make_groom("ponytail", body).select(torch.arange(0, 2400, 40))


def bent_body(body: BodyModel) -> BodyBatch:
    """Neck and head turned and bowed, and a shape of its own."""
    pose = torch.zeros(1, 81)
    for name in ("Neck", "Neck1", "Head"):
        joint = body.joint_names.index(name)
        pose[0, 3 * joint : 3 * joint + 3] = torch.tensor([0.4, 0.1, 0.3])
    return BodyBatch(body, pose, torch.linspace(-1, 1, 10)[None])


def test_tied_strands_point_to_their_tie(body: BodyModel, ponytail: Groom) -> None:
    bodies = bent_body(body)
    posed, ties = Scene(ponytail, bodies).posed[0], ties_of(ponytail, body)
    head = world_from_head(body, bodies.posed.joint_rotations)[0]
    place = bodies.posed.vertices[0, ties.anchor] + ties.offset @ head.T
    assert ponytail.tie_vertex is not None
    tie = posed[ties.strands, ponytail.tie_vertex[ties.strands].long()]
    root = root_positions(ponytail, bodies.posed.vertices, body)[0, ties.strands]
    directions = [torch.nn.functional.normalize(end - root, dim=-1) for end in (tie, place)]
    assert len(ties.strands) > 20
    torch.testing.assert_close(directions[0], directions[1], atol=1e-5, rtol=0)
    # What is left is the change of distance between root and tie.
    apart = (tie - place).norm(dim=-1)
    carriers = body.faces[ponytail.root_faces]
    own = triangle_frames(bodies.posed.vertices[0, carriers]) @ triangle_frames(body.rest_vertices[carriers]).mT
    by_triangle = posed_strands(ponytail, bodies.posed, body, own[None])[0]
    scattered = (by_triangle[ties.strands, ponytail.tie_vertex[ties.strands].long()] - place).norm(dim=-1)
    assert apart.mean() < 0.7 * scattered.mean()


def test_a_tied_groom_is_recovered_from_its_pose(body: BodyModel, ponytail: Groom) -> None:
    bodies = bent_body(body)
    motion = Motion(bodies.body_pose, 30.0, "bent")
    sequence = drape_motion(PosedDraper(), ponytail, body, motion, bodies.body_shape[0])
    found = groom_of_drape(sequence, body)
    assert (found.rest_strands - ponytail.rest_strands).norm(dim=-1).max() < 2e-3


def test_known_vertices_stand_for_the_skinned_ones(body: BodyModel, groom: Groom) -> None:
    bodies = bent_body(body)
    vertices = bodies.posed.vertices + torch.tensor([0.0, 0.0, 0.01])
    known = replace(bodies, vertices=vertices)
    assert torch.equal(known.rows(slice(0, 1)).posed.vertices, vertices[:1])
    assert torch.equal(known.posed.joint_positions, bodies.posed.joint_positions)
    moved = Scene(groom, known).posed - Scene(groom, bodies).posed
    torch.testing.assert_close(moved, torch.tensor([0.0, 0.0, 0.01]).expand_as(moved), atol=1e-5, rtol=0)
