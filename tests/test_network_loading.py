"""Drapes of the shipped network under stiffness and gravity, against the solver's."""

import math

import pytest
import torch

from quaffure.body import BodyModel, bundled_clip
from quaffure.energies import Loading
from quaffure.model import load_model
from quaffure.procedural import make_groom
from quaffure.scene import BodyBatch, Scene
from quaffure.solvers import StrandNewtonDraper

TILT = math.radians(30.0)
FINE, COARSE = Loading(stiffness=0.3), Loading(stiffness=3.0)
UPRIGHT = Loading()
LEANING = Loading(acceleration=(9.81 * math.sin(TILT), 0.0, -9.81 * math.cos(TILT)))
MOST_RATIO, MOST_ANGLE = 1.3, 15.0


@pytest.mark.slow
@pytest.mark.parametrize(("before", "after"), [(COARSE, FINE), (UPRIGHT, LEANING)])
def test_tips_move_with_a_loading_as_the_solver_moves_them(body: BodyModel, before: Loading, after: Loading) -> None:
    network, solver = load_model().draper, StrandNewtonDraper()
    moved: dict[str, list[torch.Tensor]] = {"network": [], "solver": []}
    for style, clip, frame in (("bob", "bow", 60), ("long_wavy", "neck_turn", 36)):
        groom = make_groom(style, body)
        pose = bundled_clip(clip, body).body_pose[frame : frame + 1]
        scene = Scene(groom, BodyBatch(body, pose, torch.zeros(1, 10)))
        for name, draper in (("network", network), ("solver", solver)):
            change = draper.with_loading(after).drape(scene) - draper.with_loading(before).drape(scene)
            moved[name].append(change[0, :, -1])
    by_network, by_solver = (torch.cat(changes) for changes in moved.values())
    ratio = float(by_network.norm(dim=-1).mean() / by_solver.norm(dim=-1).mean())
    cosine = torch.nn.functional.cosine_similarity(by_network.mean(0), by_solver.mean(0), dim=0)
    assert 1 / MOST_RATIO < ratio < MOST_RATIO
    assert math.degrees(math.acos(float(cosine))) < MOST_ANGLE
