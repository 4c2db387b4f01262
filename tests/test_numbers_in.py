"""Numbers that callers give: poses, shapes and grooms are refused where they enter, and changes of grooms are seen."""

import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from quaffure.baselines.posed import PosedDraper
from quaffure.body import BodyModel, Motion
from quaffure.errors import InputError
from quaffure.hair import Groom
from quaffure.io import read_drape, write_drape, write_groom
from quaffure.model.quaffure_model import Quaffure, load_model
from quaffure.scene import BodyBatch, Scene
from quaffure.solvers.by_name import solver
from quaffure.solvers.coherent_clip import CoherentDraper
from tests.synthetic_drape import drape, patch_of_strands
from tests.training_runs import tiny_groom

POSE, SHAPE = torch.zeros(1, 81), torch.zeros(1, 10)
BAD_POSES = {"NaN": float("nan"), "infinity": float("inf"), "1e30": 1e30, "4 pi and more": 12.6}
BAD_SHAPES = {"NaN": float("nan"), "1e30": 1e30, "beyond 10": 10.5}


@pytest.fixture(scope="module")
def model() -> Quaffure:
    return load_model()


@pytest.fixture(scope="module")
def made(body: BodyModel) -> Groom:
    return tiny_groom(body)


@pytest.fixture
def groom(made: Groom) -> Groom:
    """One that a test may change."""
    return made.select(torch.arange(len(made)))


def with_entry(values: torch.Tensor, column: int, number: float) -> torch.Tensor:
    changed = values.clone()
    changed[0, column] = number
    return changed


def entries(model: Quaffure, groom: Groom) -> dict[str, Callable[[torch.Tensor, torch.Tensor], object]]:
    """What takes poses and shapes."""
    return {
        "drape": lambda pose, shape: model.drape(groom, pose, shape),
        "drape_many": lambda pose, shape: list(model.drape_many([groom], pose, shape)),
        "body": lambda pose, shape: model.body.pose(pose, shape),
        "scene": lambda pose, shape: PosedDraper(model.draper.material).drape(
            Scene(groom, BodyBatch(model.body, pose, shape))
        ),
    }


@pytest.mark.parametrize("entry", ["drape", "drape_many", "body", "scene"])
def test_poses_and_shapes_that_no_body_has_are_refused(entry: str, model: Quaffure, groom: Groom) -> None:
    take = entries(model, groom)[entry]
    for number in BAD_POSES.values():
        with pytest.raises(InputError, match="body_pose: expected"):
            take(with_entry(POSE, 40, number), SHAPE)
    for number in BAD_SHAPES.values():
        with pytest.raises(InputError, match="body_shape: expected"):
            take(POSE, with_entry(SHAPE, 3, number))
    take(with_entry(POSE, 40, 12.5), with_entry(SHAPE, 3, -10.0))


@pytest.mark.parametrize("number", BAD_POSES.values(), ids=BAD_POSES.keys())
def test_motion_and_drape_files_refuse_such_poses(number: float, tmp_path: Path) -> None:
    pose = with_entry(POSE, 0, number)
    with pytest.raises(InputError, match="own: expected"):
        Motion(pose, 30.0, "own")
    seq = drape(patch_of_strands((0.0, 1.0, 0.0)))
    poses = seq.body_pose.copy()
    poses[0, 0] = number
    with pytest.raises(InputError, match="expected"):
        write_drape(tmp_path / "drape.npz", replace(seq, body_pose=poses))


def test_drape_files_refuse_shapes_and_places_that_no_body_has(tmp_path: Path) -> None:
    seq = drape(patch_of_strands((0.0, 1.0, 0.0)))
    write_drape(tmp_path / "good.npz", seq)
    with np.load(tmp_path / "good.npz") as file:
        arrays = dict(file)
    for name, found in (("body_shape", "coefficients"), ("strands", "positions"), ("body_vertices", "positions")):
        np.savez(tmp_path / "bad.npz", **arrays | {name: np.full_like(arrays[name], 1e30)})
        with pytest.raises(InputError, match=found):
            read_drape(tmp_path / "bad.npz")


def test_arrays_and_lists_are_poses_too(model: Quaffure, groom: Groom) -> None:
    expected = model.drape(groom, POSE, SHAPE)
    for pose, shape in (
        (np.zeros((1, 81)), np.zeros((1, 10), dtype=np.float32)),
        ([[0] * 81], [[0.0] * 10]),
        (list(np.zeros((1, 81))), SHAPE.double()),
    ):
        assert torch.equal(model.drape(groom, pose, shape), expected)
        assert torch.equal(next(model.drape_many([groom], pose, shape)), expected[0])
        assert torch.isfinite(model.body.pose(pose, shape).vertices).all()
    ragged, text = [[0.0] * 81, [0.0] * 80], [["a"] * 81]
    for bad in (ragged, text, [0.0] * 81, np.zeros((0, 81)), np.zeros((1, 81), complex)):
        with pytest.raises(InputError, match="body_"):
            model.drape(groom, bad, SHAPE)  # type: ignore[arg-type]


GROOM_FAULTS: dict[str, Callable[[Groom], Groom]] = {
    "no strands": lambda groom: groom.select(torch.arange(0)),
    "NaN in a vertex": lambda groom: replace(groom, rest_strands=_marred(groom.rest_strands, float("nan"))),
    "a vertex at 1e30": lambda groom: replace(groom, rest_strands=_marred(groom.rest_strands, 1e30)),
    "NaN in barycentrics": lambda groom: replace(groom, root_barycentric=_marred(groom.root_barycentric, float("nan"))),
    "infinity in barycentrics": lambda groom: replace(
        groom, root_barycentric=_marred(groom.root_barycentric, float("inf"))
    ),
    "NaN in uv": lambda groom: replace(groom, root_uv=_marred(groom.root_uv, float("nan"))),
    "NaN in goals": lambda groom: replace(groom, goal_weight=torch.full_like(groom.rest_lengths, float("nan"))),
}


def _marred(values: torch.Tensor, number: float) -> torch.Tensor:
    marred = values.clone()
    marred.view(-1)[-1] = number
    return marred


@pytest.mark.parametrize("fault", GROOM_FAULTS.values(), ids=GROOM_FAULTS.keys())
def test_grooms_that_give_no_hair_are_refused(
    fault: Callable[[Groom], Groom], model: Quaffure, groom: Groom, tmp_path: Path
) -> None:
    bad = fault(groom)
    for refused in (
        lambda: model.drape(bad, POSE, SHAPE),
        lambda: list(model.drape_many([bad], POSE, SHAPE)),
        lambda: solver("strand_newton").drape(Scene(bad, BodyBatch(model.body, POSE, SHAPE))),
        lambda: write_groom(tmp_path / "groom.npz", bad),
    ):
        with pytest.raises(InputError, match=r"expected (finite|at least one strand)"):
            refused()


def shortened(groom: Groom) -> None:
    """Half as long, by a view of numpy, which torch does not notice."""
    strands = groom.rest_strands.numpy()
    strands[:, 1:] = strands[:, :1] + 0.5 * (strands[:, 1:] - strands[:, :1])


@pytest.mark.parametrize("name", ["neural", "strand_newton", "coherent"])
def test_a_groom_that_is_changed_in_place_gives_its_new_hair(name: str, model: Quaffure, groom: Groom) -> None:
    def draper() -> object:
        kinds = {"coherent": lambda: CoherentDraper(solver("strand_newton")), "neural": lambda: load_model().draper}
        return kinds.get(name, lambda: solver(name))()

    kept = draper()
    bodies = BodyBatch(model.body, POSE, SHAPE)
    long = kept.drape(Scene(groom, bodies))
    shortened(groom)
    short = kept.drape(Scene(groom, bodies))
    assert (short[0] - long[0]).norm(dim=-1).max() > 0.01
    fresh = Groom(**{**vars(groom), "rest_strands": groom.rest_strands.clone()})
    assert torch.equal(short, draper().drape(Scene(fresh, bodies)))


SCRIPT = """
import sys, numba, torch
torch.set_num_threads(int(sys.argv[1]))
numba.set_num_threads(int(sys.argv[1]))
from quaffure.digest import array_digest
from quaffure.model.quaffure_model import load_model
from dataclasses import replace
from quaffure.procedural import STYLES, make_groom
from quaffure.scene import BodyBatch, Scene
from quaffure.solvers.by_name import solver
model = load_model()
pose, shape = torch.linspace(-0.2, 0.2, 81)[None], torch.zeros(1, 10)
groom = make_groom(replace(STYLES["long_wavy"], root_rows=24), model.body)
print(array_digest(*groom.arrays().values()), array_digest(model.drape(groom, pose, shape)))
few = groom.select(torch.arange(0, len(groom), 8))
print(array_digest(solver("strand_newton").drape(Scene(few, BodyBatch(model.body, pose, shape)))))
"""


@pytest.mark.slow
def test_grooms_and_drapes_are_the_same_with_any_number_of_threads() -> None:
    environment = os.environ | {"NUMBA_NUM_THREADS": "7", "PYTHONPATH": os.pathsep.join(sys.path)}
    outputs = {
        subprocess.run(
            [sys.executable, "-c", SCRIPT, str(threads)], capture_output=True, text=True, check=True, env=environment
        ).stdout
        for threads in (1, 7)
    }
    assert len(outputs) == 1
