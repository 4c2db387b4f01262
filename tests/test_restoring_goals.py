"""Hair that has fallen over a face returns beside it when the head is up, and only then."""

import math
from dataclasses import replace

import pytest
import torch

from quaffure.body import BodyModel
from quaffure.scene import Scene
from quaffure.solvers import CoherentDraper, CoherentSetting, RestoringGoals, StrandDescent, StrandNewtonDraper
from quaffure.types import Bool, Float, Tensor
from tests.scenes import clip_scene, few_strands, upright_scene

UNRESTORED = RestoringGoals(weight=0.0)


def _over_the_face(scene: Scene) -> tuple[Float[Tensor, "s e 3"], Bool[Tensor, " s"]]:
    """Directions of the edges with hair of the front turned by 80 degrees towards the middle, and which strands."""
    root, direction = scene.posed[0, :, 0], scene.director[0].clone()
    in_front = root[:, 1] < root[:, 1].mean() - 0.02
    for side in (-1.0, 1.0):
        cos, sin = math.cos(math.radians(80.0)), math.sin(math.radians(80.0))
        turn = torch.tensor([[cos, side * sin, 0.0], [-side * sin, cos, 0.0], [0.0, 0.0, 1.0]])
        strands = in_front & (side * root[:, 0] > 0)
        direction[strands] = direction[strands] @ turn.T
    return direction, in_front


@pytest.fixture(scope="module")
def bob(body: BodyModel) -> Scene:
    return upright_scene(few_strands(body, "bob", count=200), body)


@pytest.mark.parametrize("goals", [RestoringGoals(), UNRESTORED])
def test_hair_returns_beside_the_face(goals: RestoringGoals, bob: Scene) -> None:
    direction, in_front = _over_the_face(bob)
    follower = CoherentDraper(setting=CoherentSetting(restoring=goals))
    follower.resume(bob, torch.cat([direction.flatten(1), torch.zeros(len(direction), 1)], dim=1))
    for _ in range(10):
        draped = follower.drape(bob)
    displaced = float((draped - bob.posed)[0, in_front].norm(dim=-1).amax(dim=1).mean())
    assert (displaced < 0.015) == (goals.weight > 0)


@pytest.mark.parametrize("values", [{"energy": 0.0}, {"displacement": math.nan}, {"weight": -1.0}])
def test_what_draws_nothing_is_refused(values: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="expected energy and displacement above 0"):
        RestoringGoals(**values)


def test_gravity_keeps_hair_of_a_head_that_bows(body: BodyModel) -> None:
    scene = clip_scene(few_strands(body, count=200), body, "bow", slice(60, 61))
    hair = []
    for goals in (RestoringGoals(), UNRESTORED):
        follower = CoherentDraper(setting=CoherentSetting(restoring=goals))
        hair += [follower.drape(scene) for _ in range(5)][-1:]
    assert float((hair[0] - scene.posed).norm(dim=-1).mean()) > 0.05
    assert float((hair[0] - hair[1]).norm(dim=-1).mean()) < 0.002


def test_only_strands_that_nothing_holds_are_drawn(bob: Scene, body: BodyModel) -> None:
    goal_weight = torch.zeros(len(bob.groom), bob.groom.rest_strands.shape[1] - 1)
    goal_weight[::2, :3] = 1e-4
    scene = upright_scene(replace(bob.groom, goal_weight=goal_weight), body)
    direction, in_front = _over_the_face(scene)
    energy = StrandNewtonDraper().energy_of(scene)
    drawn, free = (StrandDescent(energy, scene.sample(0), direction=direction) for _ in range(2))
    drawn.restore(RestoringGoals())
    for descent in (drawn, free):
        descent.run_limited(1, 0.01, 0.01)
    is_drawn = torch.from_numpy((drawn.direction != free.direction).any(axis=(1, 2)))
    assert not is_drawn[::2].any()
    assert float(is_drawn[1::2][in_front[1::2]].float().mean()) > 0.8
