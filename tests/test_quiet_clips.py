"""Hair that rests stays where it is from frame to frame, and no strand comes to rest apart from the others."""

import numpy as np
import pytest
import torch

from quaffure.body import BodyModel
from quaffure.procedural import make_groom
from quaffure.scene import BodyBatch, Scene
from quaffure.solvers import CoherentDraper, CoherentSetting, StrandDescent, StrandNewtonDraper, StrandNewtonSetting
from quaffure.solvers.step_control import OscillationDamping, StepControl
from quaffure.solvers.stray_strands import APART, BESIDE, stands_apart
from tests.scenes import clip_scene, few_strands, posed_scene

UNDAMPED = OscillationDamping(first=0.0)


def _tips_move(body: BodyModel, oscillation: OscillationDamping) -> float:
    """Median displacement of the tips from a frame to the next, while the body stands still [m]."""
    scene = clip_scene(few_strands(body, count=700), body, "neck_turn", slice(20, 21))
    control = StepControl(oscillation=oscillation)
    draper = CoherentDraper(StrandNewtonDraper(setting=StrandNewtonSetting(passes=6, rounds=1, control=control)))
    tips = [draper.drape(scene)[0, :, -1] for _ in range(9)]
    return float((tips[-1] - tips[-2]).norm(dim=-1).median())


@pytest.mark.slow
def test_hair_on_a_body_that_stands_still_does_not_tremble(body: BodyModel) -> None:
    """Undamped, the tips of dense hair move by millimetres in every frame."""
    assert _tips_move(body, OscillationDamping()) < 0.4 * _tips_move(body, UNDAMPED)


def test_damping_grows_where_strands_move_back_and_decays_where_they_move_on() -> None:
    moved = np.random.default_rng(0).standard_normal((4, 5, 3)).astype(np.float32)
    across = np.cross(moved, (1.0, 2.0, 3.0)).astype(np.float32)
    before = np.stack([-moved[0], 2 * moved[1], across[2] + 0.1 * moved[2], -moved[3]])
    rule = OscillationDamping()
    damping = np.float32([0.0, 8.0, 8.0, 60.0])
    expected = [rule.first, rule.decay * 8.0, 8.0, rule.most]
    np.testing.assert_allclose(rule.updated(damping, moved, before), expected)


def test_strands_apart_from_others_are_found() -> None:
    """A row of strands 5 mm apart, of which one bends away from its middle on."""
    positions = np.zeros((6, 8, 3), np.float32)
    positions[..., 0] = 0.005 * np.arange(6)[:, None]
    positions[..., 2] = -0.01 * np.arange(8)
    assert not stands_apart(positions, BESIDE).any()
    assert stands_apart(positions, 0.004).all()
    positions[2, 4:, 1] = 0.001 + APART
    assert np.flatnonzero(stands_apart(positions, APART)).tolist() == [2]
    positions[2, 4:, 1] = 0.9 * APART
    assert not stands_apart(positions, APART).any()


def _with_a_stray(body: BodyModel, by_design: bool = False) -> tuple[StrandDescent, int, int]:
    """Hair as it was posed, of which the strand of index 20 stands off, as it was posed too where that is its design;
    how many strays there were."""
    scene = clip_scene(make_groom("long_straight", body), body, "neck_turn", slice(0, 1))
    off = torch.nn.functional.normalize(scene.posed[0, 20, 0] - scene.posed[0, :, 0].mean(0), dim=-1)
    energy, sample, direction = StrandNewtonDraper().energy_of(scene), scene.sample(0), scene.director[0].clone()
    direction[20] = off
    if by_design:
        posed = sample.posed.clone()
        along = torch.cat([torch.zeros(1), scene.groom.rest_lengths[20].cumsum(0)])
        posed[0, 20] = posed[0, 20, 0] + along[:, None] * off
        sample = posed_scene(scene.groom, posed, sample.surface)
    descent = StrandDescent(energy, sample, direction=direction)
    others = np.delete(np.arange(len(direction)), 20)
    root = scene.posed[0, :, 0]
    nearest = int(others[(root[others] - root[20]).norm(dim=-1).argmin()])
    return descent, descent.rejoin_strays(), nearest


def test_a_stray_takes_the_shape_of_its_nearest_neighbour(body: BodyModel) -> None:
    descent, count, nearest = _with_a_stray(body)
    assert count == 1
    np.testing.assert_array_equal(descent.direction[20], descent.direction[nearest])


def test_strands_that_stand_alone_by_design_are_left_there(body: BodyModel) -> None:
    descent, count, nearest = _with_a_stray(body, by_design=True)
    assert count == 0
    assert not np.array_equal(descent.direction[20], descent.direction[nearest])


@pytest.mark.slow
def test_the_first_frame_of_a_clip_has_fewer_strays(body: BodyModel) -> None:
    scene = clip_scene(make_groom("long_straight", body), body, "neck_turn", slice(0, 1))
    alone, gathered = (
        int(stands_apart(CoherentDraper(setting=setting).drape(scene)[0].numpy(), APART).sum())
        for setting in (CoherentSetting(stray_rounds=0), CoherentSetting())
    )
    assert gathered < 0.6 * alone


def test_a_clip_goes_on_from_its_state(body: BodyModel) -> None:
    """Damping is part of it: two frames in which strands have moved back and forth, then two more."""
    groom = few_strands(body, "bob", count=300)
    scene = clip_scene(groom, body, "neck_turn", slice(30, 34))
    whole = CoherentDraper().drape(scene)
    first, later = CoherentDraper(), CoherentDraper()
    half = Scene(groom, BodyBatch(body, scene.bodies.body_pose[:2], scene.bodies.body_shape[:2]))
    first.drape(half)
    assert first.state is not None
    assert float(first.state[:, -1].max()) > 0.0
    later.resume(half, first.state)
    rest = Scene(groom, BodyBatch(body, scene.bodies.body_pose[2:], scene.bodies.body_shape[2:]))
    assert torch.equal(later.drape(rest), whole[2:])
