"""Clips in which every frame follows the last one."""

from dataclasses import replace

import numba
import numpy as np
import pytest
import torch

from quaffure.benchmark.appearance import jumps
from quaffure.body import BodyModel, bundled_clip
from quaffure.drape_motion import drape_motion
from quaffure.scene import BodyBatch, Scene
from quaffure.solvers import (
    CoherentDraper,
    CoherentSetting,
    StrandNewtonDraper,
)
from tests.scenes import clip_scene, few_strands, upright_scene


def test_clips_follow_the_last_frame(body: BodyModel) -> None:
    scene = clip_scene(few_strands(body), body, "neck_turn", slice(20, 26))
    setting = CoherentSetting(max_frame_displacement=0.02)
    follower = CoherentDraper(setting=setting)
    draped = torch.cat([follower.drape(_part(scene, frame)) for frame in range(6)])
    tips, roots, posed = draped[:, :, -1], draped[:, :, 0], scene.posed[:, :, -1]
    own = tips.diff(dim=0).norm(dim=-1)
    carried = torch.maximum(roots.diff(dim=0).norm(dim=-1), posed.diff(dim=0).norm(dim=-1))
    assert float((own - carried).max()) < setting.max_frame_displacement + 0.01
    energy = follower.draper.energy_of(scene)
    assert float(energy.per_vertex(energy.total(draped, scene)).max()) < 0.0
    together = CoherentDraper(setting=setting).drape(scene)
    assert torch.equal(together, draped)


def test_hair_does_not_sweep_around_a_head_that_turns_fast(body: BodyModel) -> None:
    """Hanging from a bowed head that is shaken: far from where it was posed, so the head moves it farther."""
    pose = bundled_clip("bow", body).body_pose[60]
    poses = pose.repeat(5, 1)
    poses[:, 3 * body.joint_names.index("Head") + 2] += 0.3 * torch.arange(5)
    scene = Scene(few_strands(body), BodyBatch(body, poses, torch.zeros(5, 10)))
    limited, unlimited = (
        float(jumps(CoherentDraper(setting=setting).drape(scene), scene.posed).max())
        for setting in (CoherentSetting(), CoherentSetting(max_head_sweep=1.0))
    )
    assert limited < 0.05 < unlimited


def _part(scene: Scene, frame: int) -> Scene:
    return Scene(scene.groom, scene.bodies.rows(slice(frame, frame + 1)))


def test_a_cut_in_the_motion_starts_anew(body: BodyModel) -> None:
    groom = few_strands(body, count=20)
    bowed, upright = clip_scene(groom, body, "bow", slice(60, 61)), upright_scene(groom, body)
    follower = CoherentDraper()
    follower.drape(bowed)
    torch.testing.assert_close(follower.drape(upright), StrandNewtonDraper().drape(upright))


def test_a_motion_is_draped_the_same_whatever_was_draped_before(body: BodyModel) -> None:
    """The bow has just begun: near enough to upright hair for its first frame to follow."""
    groom = few_strands(body, count=20)
    motion = bundled_clip("bow", body).frames("14:16")
    follower = CoherentDraper()
    once = drape_motion(follower, groom, body, motion, torch.zeros(10)).strands
    again = drape_motion(follower, groom, body, motion, torch.zeros(10)).strands
    continued = drape_motion(follower, groom, body, motion, torch.zeros(10), continues=True).strands
    assert np.array_equal(again, once)
    assert not np.array_equal(continued, once)


@pytest.mark.parametrize(("step", "passes", "moved"), [(1, (2, 4), 0.038), (4, (8, 16), 0.152)])
def test_limits_of_a_frame_grow_with_its_time(
    step: int, passes: tuple[int, int], moved: float, body: BodyModel
) -> None:
    follower = CoherentDraper()
    motion = bundled_clip("neck_turn", body).frames(f"30:34:{step}")
    drape_motion(follower, few_strands(body, count=5), body, motion, torch.zeros(10))
    setting = follower.setting.over(follower.frame_seconds)
    assert (setting.passes, setting.max_passes) == passes
    assert setting.max_frame_displacement == pytest.approx(moved)
    assert setting.max_head_sweep == pytest.approx(step * follower.setting.max_head_sweep)
    assert setting.max_pass_displacement == follower.setting.max_pass_displacement


def test_frames_of_a_short_time_keep_the_passes_that_damping_compares() -> None:
    setting = CoherentSetting().over(1 / 60)
    assert (setting.passes, setting.max_passes) == (2, 2)
    assert setting.max_frame_displacement == pytest.approx(0.019)


def test_hair_falls_no_further_behind_where_frames_are_left_out(body: BodyModel) -> None:
    groom, shape = few_strands(body), torch.zeros(10)
    motion = bundled_clip("neck_turn", body).frames("20:53")
    whole = torch.from_numpy(drape_motion(CoherentDraper(), groom, body, motion, shape).strands)[::4]
    every_fourth = motion.frames("::4")
    scaled = torch.from_numpy(drape_motion(CoherentDraper(), groom, body, every_fourth, shape).strands)
    as_at_30 = drape_motion(CoherentDraper(), groom, body, replace(every_fourth, fps=30.0), shape).strands
    behind = [float((hair - whole)[:, :, -1].norm(dim=-1).mean()) for hair in (scaled, torch.from_numpy(as_at_30))]
    assert behind[0] < 0.7 * behind[1]


def test_frames_far_apart_are_settled_one_by_one(body: BodyModel) -> None:
    groom, shape = few_strands(body, count=10), torch.zeros(10)
    motion = replace(bundled_clip("neck_turn", body).frames("20:22"), fps=1.9)
    found = drape_motion(CoherentDraper(), groom, body, motion, shape).strands
    assert np.array_equal(found, drape_motion(StrandNewtonDraper(), groom, body, motion, shape).strands)


def test_clips_are_the_same_bits_with_any_number_of_threads(body: BodyModel) -> None:
    scene = clip_scene(few_strands(body, "bob"), body, "neck_turn", slice(30, 32))
    drapes = []
    threads = numba.get_num_threads()
    try:
        for count in (1, numba.config.NUMBA_NUM_THREADS):
            numba.set_num_threads(count)
            drapes.append(CoherentDraper().drape(scene))
    finally:
        numba.set_num_threads(threads)
    assert torch.equal(*drapes)
