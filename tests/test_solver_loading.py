"""Stiffness, gravity and wind in every solver that takes them, and on the command line."""

import json
from pathlib import Path

import numpy as np
import pytest

from quaffure import HairMaterial
from quaffure.apps.cli.main import main
from quaffure.body import BodyModel
from quaffure.energies import Loading
from quaffure.solvers import DesignSolver
from tests.scenes import few_strands, upright_scene

SLOW = (pytest.param(name, marks=pytest.mark.slow) for name in ("adam", "lbfgs", "xpbd"))


@pytest.mark.parametrize("name", ["strand_newton", *SLOW])
def test_hair_swings_with_gravity_and_soft_hair_further(body: BodyModel, name: str) -> None:
    scene = upright_scene(few_strands(body, "bob", count=30), body)  # longer hair lies on shoulders, on either side
    swung = {}
    for stiffness in (0.3, 3.0):
        hair = DesignSolver(name, HairMaterial()).with_loading(Loading(stiffness, (4.0, 0.0, -9.0))).drape(scene)
        swung[stiffness] = (hair - scene.posed)[0, :, -1].mean(dim=0)
    assert float(swung[3.0][0]) > 0.01
    assert float(swung[0.3][0]) > 2 * float(swung[0.3][1].abs())
    assert float(swung[0.3][0]) > 1.5 * float(swung[3.0][0])


def test_weight_gravity_and_wind_of_the_command_line_add_up(tiny_groom_file: Path, tmp_path: Path) -> None:
    drape = ["drape", str(tiny_groom_file), "--motion", "idle", "--frames", "0", "--out"]
    main([*drape, str(tmp_path / "calm.npz")])
    loading = ("--stiffness", "2", "--weight", "0.5", "--gravity", "0,1,-8", "--wind", "9,0,0")
    main([*drape, str(tmp_path / "wind.npz"), *loading])
    with np.load(tmp_path / "calm.npz") as calm, np.load(tmp_path / "wind.npz") as wind:
        meta = json.loads(str(wind["meta"]))
        assert meta["stiffness"] == 2
        assert meta["acceleration"] == pytest.approx([9.0, 0.5, -4.0])
        assert (wind["strands"] - calm["strands"])[0, :, -1, 0].mean() > 0.01
