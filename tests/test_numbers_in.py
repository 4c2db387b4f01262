"""Numbers that callers give: poses, shapes and grooms are refused where they enter, and changes of grooms are seen."""

import inspect
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import quaffure
from quaffure import HairMaterial, InputError
from quaffure.baselines import PosedDraper
from quaffure.body import BodyModel, Motion
from quaffure.energies import Loading, hair_terms
from quaffure.hair import Groom
from quaffure.hair.groom_binding import groom_binding
from quaffure.io import read_drape, read_groom, write_drape, write_groom
from quaffure.model import Quaffure, load_model
from quaffure.scene import BodyBatch, Scene
from quaffure.solvers import CoherentDraper, solver
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


def test_motions_bodies_and_clips_take_arrays_and_lists(body: BodyModel, groom: Groom) -> None:
    few, pose = groom.select(torch.arange(3)), torch.linspace(-0.2, 0.2, 81)[None]
    motion = Motion(pose, 30.0, "own", torch.ones(1, 3))
    assert motion.body_pose is pose
    posed = PosedDraper(HairMaterial())
    expected = quaffure.drape_clip(few, motion, torch.full((10,), 0.5), posed)
    for numbers in (
        lambda tensor: tensor.numpy(),
        lambda tensor: tensor.double().numpy(),
        lambda tensor: tensor.tolist(),
    ):
        same = Motion(numbers(pose), 30.0, "own", numbers(motion.translation))
        assert torch.equal(same.body_pose, pose)
        assert same.translation is not None
        assert same.translation.dtype is torch.float32
        drape = quaffure.drape_clip(few, same, numbers(torch.full((10,), 0.5)), posed)
        np.testing.assert_array_equal(drape.strands, expected.strands)
        bodies = BodyBatch(body, numbers(pose), numbers(torch.full((1, 10), 0.5)))
        assert torch.equal(bodies.posed.vertices, BodyBatch(body, pose, torch.full((1, 10), 0.5)).posed.vertices)
        binding = groom_binding(few, body, numbers(torch.full((10,), 0.5)))
        assert np.isfinite(binding.strands).all()


def test_tensors_of_bodies_keep_their_gradients(body: BodyModel) -> None:
    pose, shape = torch.zeros(1, 81, requires_grad=True), torch.zeros(1, 10, dtype=torch.float64)
    bodies = BodyBatch(body, pose, shape)
    assert bodies.body_pose is pose
    assert bodies.body_shape is shape


@pytest.mark.parametrize("bad", [["a"] * 10, [0.0] * 9, [[0.0] * 10], [[0.0], [0.0, 1.0]], [1e300] * 10])
def test_numbers_of_another_layout_are_refused(bad: Any, body: BodyModel, groom: Groom) -> None:
    motion = Motion(POSE, 30.0, "own")
    for refused in (
        lambda: quaffure.drape_clip(groom, motion, bad),
        lambda: groom_binding(groom, body, bad),
        lambda: BodyBatch(body, bad, SHAPE),
        lambda: BodyBatch(body, POSE, [bad, bad]),
        lambda: Motion(bad, 30.0, "own"),
        lambda: Motion(POSE, 30.0, "own", bad),
    ):
        with pytest.raises(InputError):
            refused()


EDGES, TIES = "edges longer than 1e-06", "tie_vertex of -1"
GROOM_FAULTS: dict[str, tuple[Callable[[Groom], Groom], str]] = {
    "no strands": (lambda groom: groom.select(torch.arange(0)), "at least one strand"),
    "NaN in a vertex": (lambda groom: marred(groom, "rest_strands", float("nan")), "finite"),
    "a vertex at 1e30": (lambda groom: marred(groom, "rest_strands", 1e30), "finite"),
    "NaN in barycentrics": (lambda groom: marred(groom, "root_barycentric", float("nan")), "finite"),
    "infinity in barycentrics": (lambda groom: marred(groom, "root_barycentric", float("inf")), "finite"),
    "other barycentrics": (lambda groom: marred(groom, "root_barycentric", 3.0), "barycentric coordinates that sum"),
    "NaN in uv": (lambda groom: marred(groom, "root_uv", float("nan")), "finite"),
    "uv off the chart": (lambda groom: marred(groom, "root_uv", 1.5), "root_uv in the unit square"),
    "NaN in goals": (lambda groom: held(groom, "goal_weight", float("nan")), "finite"),
    "goals below 0": (lambda groom: held(groom, "goal_weight", -1.0), "goal_weight from 0"),
    "goals of 1e30": (lambda groom: held(groom, "goal_weight", 1e30), "goal_weight from 0 to 100"),
    "stiffness below 0": (lambda groom: held(groom, "stiffness_scale", -1.0), "stiffness_scale from 1"),
    "stiffness of 1e30": (lambda groom: held(groom, "stiffness_scale", 1e30), "stiffness_scale from 1"),
    "two vertices in one place": (
        lambda groom: replace(groom, rest_strands=coinciding(groom)),
        EDGES,
    ),
    "only roots": (
        lambda groom: replace(groom, rest_strands=groom.rest_strands[:, :1].expand_as(groom.rest_strands)),
        EDGES,
    ),
    "a tie beyond the tip": (
        lambda groom: replace(groom, tie_vertex=torch.full((len(groom),), 24)),
        TIES,
    ),
    "a tie below -1": (lambda groom: replace(groom, tie_vertex=torch.full((len(groom),), -2)), TIES),
    "a tie of each vertex": (lambda groom: replace(groom, tie_vertex=torch.full((len(groom), 24), -1)), "of shape"),
    "ties of another type": (lambda groom: replace(groom, tie_vertex=torch.zeros(len(groom))), "whole numbers as tie"),
    "faces below 0": (lambda groom: marred(groom, "root_faces", -1), "root_faces that are faces"),
    "faces of another type": (
        lambda groom: replace(groom, root_faces=groom.root_faces.double()),
        "whole numbers as root",
    ),
    "fewer faces": (lambda groom: replace(groom, root_faces=groom.root_faces[:-1]), "root_faces of shape"),
    "one vertex": (lambda groom: replace(groom, rest_strands=groom.rest_strands[:, :1]), "vertices >= 2"),
    "an array": (lambda groom: replace(groom, root_uv=groom.root_uv.numpy()), "a tensor as root_uv"),
}
OF_ANOTHER_BODY: dict[str, tuple[Callable[[Groom], Groom], str]] = {
    "a face beyond the body's": (lambda groom: marred(groom, "root_faces", 10**6), "root_faces that are faces"),
}


def marred(groom: Groom, name: str, number: float) -> Groom:
    """With another number at the end of an array."""
    values = getattr(groom, name).clone()
    values.view(-1)[-1] = number
    return with_array(groom, name, values)


def held(groom: Groom, name: str, number: float) -> Groom:
    return with_array(groom, name, torch.full_like(groom.rest_lengths, number))


def with_array(groom: Groom, name: str, values: torch.Tensor) -> Groom:
    return replace(groom, **{name: values})  # type: ignore[arg-type]


def coinciding(groom: Groom) -> torch.Tensor:
    strands = groom.rest_strands.clone()
    strands[1, 7] = strands[1, 6]
    return strands


@pytest.mark.parametrize("fault", [*GROOM_FAULTS, *OF_ANOTHER_BODY])
def test_grooms_that_give_no_hair_are_refused(fault: str, model: Quaffure, groom: Groom, tmp_path: Path) -> None:
    spoil, expected = (GROOM_FAULTS | OF_ANOTHER_BODY)[fault]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            Groom, "__init__", getattr(Groom.__init__, "__wrapped__", Groom.__init__)
        )  # unchecked by beartype
        bad = spoil(groom)
    entries: list[Callable[[], object]] = [
        lambda: model.drape(bad, POSE, SHAPE),
        lambda: list(model.drape_many([bad], POSE, SHAPE)),
        lambda: solver("strand_newton").drape(Scene(bad, BodyBatch(model.body, POSE, SHAPE))),
        lambda: write_groom(tmp_path / "groom.npz", bad),
    ]
    for refused in entries[: 3 if fault in OF_ANOTHER_BODY else 4]:
        with pytest.raises(InputError, match=f"expected .*{expected}"):
            refused()
    assert not list(tmp_path.iterdir())


def test_what_is_written_is_read(model: Quaffure, groom: Groom, tmp_path: Path) -> None:
    """At the limits that both have."""
    strands = groom.rest_strands.clone()
    edge = strands[0, 5] - strands[0, 4]
    strands[0, 5:] += edge * (2e-6 / edge.norm() - 1)
    short = replace(groom, rest_strands=strands)
    short = replace(short, stiffness_scale=torch.full_like(short.rest_lengths, 1e6))
    write_groom(tmp_path / "groom.npz", short)
    assert torch.equal(read_groom(tmp_path / "groom.npz", model.body).rest_strands, strands)
    assert model.drape(short, POSE, SHAPE).isfinite().all()


def test_a_groom_that_is_spoiled_in_place_is_refused(model: Quaffure, groom: Groom) -> None:
    model.drape(groom, POSE, SHAPE)
    groom.rest_strands[1, 7] = groom.rest_strands[1, 6]
    with pytest.raises(InputError, match="edges longer"):
        model.drape(groom, POSE, SHAPE)


BAD_LOADINGS = {
    "a wind of 1e30": Loading(acceleration=(1e30, 0.0, 0.0)),
    "gravity of 1e30": Loading(acceleration=(0.0, 0.0, 1e30)),
    "gravity of a huge whole number": Loading(acceleration=(0, 0, 10**400)),
    "gravity that is none": Loading(acceleration=(0.0, 0.0, float("nan"))),
    "stiffness of 1e30": Loading(1e30),
    "stiffness of 1e-30": Loading(1e-30),
    "stiffness below 0": Loading(-1.0),
    "one edge below 0": Loading(torch.tensor([[1.0, -1.0]])),
}


@pytest.mark.parametrize("loading", BAD_LOADINGS.values(), ids=BAD_LOADINGS.keys())
def test_loadings_that_give_no_hair_are_refused(loading: Loading, model: Quaffure) -> None:
    for refused in (
        lambda: model.with_loading(loading),
        lambda: solver("strand_newton").with_loading(loading),  # type: ignore[attr-defined]
        lambda: hair_terms("rod", None, loading.stiffness, loading.acceleration),
    ):
        with pytest.raises(InputError, match=r"(stiffness|acceleration): expected"):
            refused()


@pytest.mark.parametrize("loading", [Loading(1e-4), Loading(1e4), Loading(acceleration=(0.0, 2e4, -2e4))])
def test_loadings_at_the_limits_give_hair(loading: Loading, model: Quaffure, groom: Groom) -> None:
    few = groom.select(torch.arange(0, 40, 8))
    for draper in (model.draper, solver("strand_newton")):
        hair = draper.with_loading(loading).drape(Scene(few, BodyBatch(model.body, POSE, SHAPE)))  # type: ignore[attr-defined]
        assert hair.isfinite().all()


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


def test_names_and_other_types_in_place_of_what_is_loaded_are_refused(body: BodyModel, tmp_path: Path) -> None:
    few = quaffure.load_groom("crew_cut", body).thinned(5)
    motion = quaffure.load_motion("idle", body).frames(3)
    assert len(motion) == 1
    clip = quaffure.drape_clip(few, motion, draper=PosedDraper())
    drape_clip, draw = inspect.unwrap(quaffure.drape_clip), inspect.unwrap(quaffure.draw)  # without the types' checks
    for call, text in (
        (lambda: drape_clip("bob", motion), "groom: expected a Groom, .*found 'bob'"),
        (lambda: drape_clip(few, "idle"), "motion: expected a Motion, .*found 'idle'"),
        (lambda: drape_clip(few, motion, draper="neural"), "draper: expected a Draper, .*found 'neural'"),
        (lambda: quaffure.draw(clip, -2), "frame: expected a whole number from 0 to 0, found -2"),
        (lambda: draw(clip, "0"), "frame: expected a whole number from 0 to 0, found '0'"),
        (lambda: quaffure.draw(clip, size=20_000), "size: expected 16 to 8192 pixels, found 20000"),
        (lambda: quaffure.save_drape(clip, tmp_path / "hair.usd", motion="a.glb#Run"), "on the shipped body"),
        (lambda: few.thinned(0), "crew_cut: expected at least one strand, found 0"),
        (lambda: quaffure.load_motion(str(tmp_path)), "expected a motion file, found a folder"),
    ):
        with pytest.raises(InputError, match=text):
            call()
    assert not list(tmp_path.iterdir())


def test_files_are_read_and_written_by_names_that_are_text(body: BodyModel, tmp_path: Path) -> None:
    few = quaffure.load_groom("crew_cut", body).thinned(5)
    name = str(tmp_path / "groom.npz")
    write_groom(name, few)
    assert torch.equal(read_groom(name, body).rest_strands, few.rest_strands)
    name = str(tmp_path / "drape.npz")
    clip = drape(patch_of_strands((0.0, 1.0, 0.0)))
    write_drape(name, clip)
    np.testing.assert_array_equal(read_drape(name).strands, clip.strands)
    with pytest.raises(
        InputError, match=r"expected a drape file .*found another \.npz, with the arrays format_version"
    ):
        read_drape(str(tmp_path / "groom.npz"))


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
