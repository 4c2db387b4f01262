"""The supervised baseline: its drapes, its training, its draper and its commands."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
import torch

from quaffure import HairMaterial, InputError
from quaffure.apps.cli.main import main
from quaffure.baselines import (
    GroomGenDraper,
    GroomGenLayers,
    GroomGenNetwork,
    PosedDraper,
    load_groomgen,
    save_groomgen,
)
from quaffure.baselines.groomgen import head_strands, texel_cells
from quaffure.benchmark.methods import methods
from quaffure.body import BodyModel, bundled_clip, head_rotation, neck_pose
from quaffure.body.neck import NECK_SHARES
from quaffure.hair import Groom
from quaffure.io import write_groom
from quaffure.procedural import HELD_OUT
from quaffure.scene import BodyBatch, Scene
from quaffure.training import DrapeFolder, GroomGenConfig, GroomGenRecipe, Training, random_head_rotation, train
from quaffure.training.groomgen_data import LARGEST_TURN, DrapedPoses, started_folder
from quaffure.types import Positions
from tests.training_runs import rows_of, tiny_groom

NARROW = GroomGenLayers(latent_size=4, strand_width=16, widths=(16, 16, 16, 16))
TINY = GroomGenConfig(network=NARROW, steps=6, batch=2, warmup=1, validate_every=2, save_every_seconds=0)
OPTIONS = (
    "--latent-size",
    "4",
    "--strand-width",
    "16",
    "--widths",
    "16",
    "16",
    "16",
    "16",
    "--batch",
    "2",
    "--warmup",
    "1",
    "--validate-every",
    "2",
)
POSES = 6


class LeaningDraper(PosedDraper):
    """Every vertex moves along the head's own x by 2 cm for each radian that the head turns to the left."""

    name = "leaning"

    def drape(self, scene: Scene) -> Positions:
        turn = head_rotation(scene.bodies.body, scene.bodies.posed.joint_rotations)
        head = scene.bodies.posed.joint_rotations[:, scene.bodies.body.joint_names.index("Head")]
        moved = 0.02 * turn[:, 2, None] * head[:, :, 0]
        draped = scene.posed + moved[:, None, None]
        draped[:, :, 0] = scene.posed[:, :, 0]
        return draped


@pytest.fixture(scope="module")
def groom(body: BodyModel) -> Groom:
    return tiny_groom(body)


@pytest.fixture
def drapes(groom: Groom, body: BodyModel, tmp_path: Path) -> DrapeFolder:
    folder = started_folder(tmp_path / "data", groom, body, "leaning", LeaningDraper(), seed=0)
    for pose in range(POSES):
        folder.drape(pose, LeaningDraper())
    return folder


@pytest.fixture
def refused(capfd: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Runs a command that must fail with exit code 2, and gives the one line it says."""

    def refused(*arguments: str | Path) -> str:
        with pytest.raises(SystemExit) as stop:
            main([str(argument) for argument in arguments])
        errors = capfd.readouterr().err
        assert stop.value.code == 2, errors
        assert errors.count("\n") == 1
        return errors

    return refused


def network_of(groom: Groom, body: BodyModel, seed: int = 0) -> GroomGenNetwork:
    """One that moves hair, as a trained one does."""
    torch.manual_seed(seed)
    network = GroomGenNetwork(NARROW, head_strands(groom, body), texel_cells(groom))
    torch.nn.init.normal_(network.strand[-1].weight, std=0.1)
    return network.eval()


def scene_of(groom: Groom, body: BodyModel, *turns: tuple[float, float, float]) -> Scene:
    return Scene(groom, BodyBatch(body, neck_pose(body, torch.tensor(turns)), torch.zeros(len(turns), 10)))


# ---- poses


def test_the_neck_shares_a_turn_that_can_be_read_back(body: BodyModel) -> None:
    assert sum(NECK_SHARES.values()) == pytest.approx(1)
    turn = torch.stack([random_head_rotation(0, pose) for pose in range(8)])
    pose = neck_pose(body, turn)
    moved = [body.joint_names[joint] for joint in range(27) if pose.unflatten(1, (27, 3))[:, joint].abs().max() > 0]
    assert set(moved) == set(NECK_SHARES)
    rotations = body.posed_joints(pose, torch.zeros(8, 10))[0]
    torch.testing.assert_close(head_rotation(body, rotations), turn, atol=1e-5, rtol=0)
    # A body that leans and turns as a whole holds its head as before.
    pose[:, :3] = torch.tensor([0.3, 0.2, 1.0])
    torch.testing.assert_close(
        head_rotation(body, body.posed_joints(pose, torch.zeros(8, 10))[0]), turn, atol=1e-5, rtol=0
    )
    clip = bundled_clip("neck_turn", body)
    first = head_rotation(body, body.posed_joints(clip.body_pose[:1], torch.zeros(1, 10))[0])
    torch.testing.assert_close(first[0], torch.tensor([0.0, 0.0, -math.radians(70)]), atol=1e-4, rtol=0)


def test_poses_are_drawn_by_number_within_thirty_degrees() -> None:
    turns = torch.stack([random_head_rotation(5, pose) for pose in range(300)])
    assert float(turns.abs().max()) <= LARGEST_TURN == math.radians(30)
    assert (turns.abs().max(dim=0).values > 0.9 * LARGEST_TURN).all()
    assert (turns.mean(dim=0).abs() < 0.1 * LARGEST_TURN).all()
    assert torch.equal(random_head_rotation(5, 7), turns[7])
    assert not torch.equal(random_head_rotation(6, 7), turns[7])


# ---- drapes on disk


def test_drapes_come_back_as_displacements_in_the_heads_frame(drapes: DrapeFolder) -> None:
    seen: list[int] = []
    data = drapes.read(seen.append)
    assert seen == list(range(1, POSES + 1))
    expected = torch.stack([random_head_rotation(0, pose) for pose in range(POSES)])
    torch.testing.assert_close(data.turn, expected, atol=1e-5, rtol=0)
    along = (0.02 * expected[:, 2])[:, None, None].expand(data.displacement.shape[:3]).clone()
    along[:, :, 0] = 0
    moved = data.displacement.float()
    torch.testing.assert_close(moved[..., 0], along, atol=2e-5, rtol=0)
    assert moved[..., 1:].abs().max() < 2e-5


def test_a_folder_of_drapes_carries_on_and_holds_one_kind_alone(
    drapes: DrapeFolder, groom: Groom, body: BodyModel
) -> None:
    path, leaning = drapes.path, LeaningDraper()
    assert drapes.missing(range(POSES + 2)) == [POSES, POSES + 1]
    # Grown elsewhere, a groom differs in its last digits; what is draped stays the first one.
    grown = replace(groom, rest_strands=groom.rest_strands + 1e-6)
    again = started_folder(path, grown, body, "leaning", leaning, seed=0)
    assert torch.equal(again.groom.rest_strands, groom.rest_strands)
    with pytest.raises(InputError, match="drapes of seed 1, found of seed 0"):
        started_folder(path, groom, body, "leaning", leaning, seed=1)
    with pytest.raises(InputError, match="drapes of solver xpbd, found of solver leaning"):
        started_folder(path, groom, body, "xpbd", leaning, seed=0)
    stiff = LeaningDraper(HairMaterial(k_cosserat=1.0))
    with pytest.raises(InputError, match="drapes of material"):
        started_folder(path, groom, body, "leaning", stiff, seed=0)
    for other in (groom.select(torch.arange(5)), replace(groom, rest_strands=groom.rest_strands + 1e-3)):
        with pytest.raises(InputError, match="found of another of that name"):
            started_folder(path, other, body, "leaning", leaning, seed=0)


def test_damaged_folders_of_drapes_are_refused(drapes: DrapeFolder, groom: Groom, body: BodyModel) -> None:
    path = drapes.path
    pose = drapes.pose_file(3)
    whole = dict(np.load(pose))
    for damage in (
        {"strands": whole["strands"][:-1]},
        {"strands": np.full_like(whole["strands"], np.nan)},
        {"body_pose": whole["body_pose"].astype(np.float64)},
    ):
        np.savez(pose, **(whole | damage))
        with pytest.raises(InputError, match=r"pose_00003\.npz: expected a draped pose .* with "):
            drapes.read()
    np.savez(pose, **(whole | {"strands": np.full_like(whole["strands"], 1e6)}))
    with pytest.raises(InputError, match=r"pose_00003\.npz: expected a draped pose .*near the head"):
        drapes.read()
    pose.write_bytes(b"none")
    with pytest.raises(InputError, match="pose_00003"):
        drapes.read()
    for file in path.glob("pose_*"):
        file.unlink()
    with pytest.raises(InputError, match="expected draped poses"):
        drapes.read()
    manifest = json.loads((path / "manifest.json").read_text())
    changes = ({"body": "another"}, {"material": {"glue": 1}}, {"groom": []}, {"solver": None})
    for damage in (*(manifest | change for change in changes), {}, []):
        (path / "manifest.json").write_text(json.dumps(damage))
        with pytest.raises(InputError, match=r"body another|manifest"):
            DrapeFolder(path, body)
    (path / "manifest.json").write_text(json.dumps(manifest))
    write_groom(path / "groom.npz", replace(groom, rest_strands=groom.rest_strands + 1e-5))
    with pytest.raises(InputError, match=r"groom\.npz: expected the groom"):
        DrapeFolder(path, body)
    (path / "manifest.json").unlink()
    with pytest.raises(InputError, match="no such file"):
        DrapeFolder(path, body)


def test_a_solver_that_fails_leaves_no_drape(drapes: DrapeFolder) -> None:
    failing = mock.Mock(spec=PosedDraper, material=HairMaterial())
    failing.name = "failing"
    failing.drape.return_value = torch.full((1, len(drapes.groom), 24, 3), torch.nan)
    with pytest.raises(InputError, match="failing: expected finite vertices in pose 6"):
        drapes.drape(POSES, failing)
    assert drapes.missing([POSES]) == [POSES]


# ---- training


@pytest.mark.slow
def test_training_learns_what_a_solver_did(drapes: DrapeFolder, tmp_path: Path) -> None:
    turn = torch.linspace(-0.5, 0.5, 40)[:, None] * torch.tensor([0.3, 0.2, 1.0])
    displacement = torch.zeros(40, *drapes.groom.rest_strands.shape)
    displacement[:, :, 1:, 0] = 0.02 * turn[:, 2, None, None]
    data = DrapedPoses(turn, displacement.half())
    config = replace(TINY, steps=80, batch=8, warmup=5, learning_rate=3e-3)
    training = Training(GroomGenRecipe(config, drapes, data), tmp_path / "run")
    before = training.validate()
    untrained = training.recipe.network(turn[:1]).detach()[0]
    torch.testing.assert_close(untrained, data.displacement[training.recipe.trained].float().mean(0), atol=1e-6, rtol=0)
    train(training, lambda step, figures: None)
    after = training.validate()
    assert after["posed_distance_mm"] == before["posed_distance_mm"] > 1
    assert after["distance_mm"] < 0.2 * before["distance_mm"]
    assert after["distance_mm"] <= after["rms_mm"]
    network = load_groomgen(tmp_path / "run/best.safetensors")[0].network
    off = (network(turn[training.recipe.validated]).detach() - displacement[training.recipe.validated])[:, :, 1:].norm(
        dim=-1
    )
    assert 1000 * float(off.mean()) == pytest.approx(training.best, rel=0.02)


def test_a_tenth_of_the_poses_is_never_trained_on(drapes: DrapeFolder, tmp_path: Path) -> None:
    data = DrapedPoses(torch.zeros(40, 3), torch.zeros(40, *drapes.groom.rest_strands.shape).half())
    training = Training(GroomGenRecipe(replace(TINY, batch=200), drapes, data), tmp_path / "run")
    assert len(training.recipe.validated) == 4
    assert sorted([*training.recipe.validated.tolist(), *training.recipe.trained.tolist()]) == list(range(40))
    # What is validated would show as NaN.
    data.displacement[training.recipe.validated] = torch.nan
    assert math.isfinite(next(training.steps())["train_rms_mm"])
    with pytest.raises(InputError, match="two draped poses or more"):
        Training(GroomGenRecipe(TINY, drapes, DrapedPoses(data.turn[:1], data.displacement[:1])), tmp_path / "run")


@pytest.mark.slow
def test_a_stopped_training_ends_like_an_unbroken_one(drapes: DrapeFolder, tmp_path: Path) -> None:
    data = drapes.read()
    whole = Training(GroomGenRecipe(TINY, drapes, data), tmp_path / "whole")
    train(whole, lambda step, figures: None)

    class Stopped(Exception):
        pass

    def stop(step: int, figures: dict[str, float]) -> None:
        if step == 4:
            raise Stopped

    stopped = Training(GroomGenRecipe(TINY, drapes, data), tmp_path / "stopped")
    with pytest.raises(Stopped):
        train(stopped, stop)
    resumed = Training(GroomGenRecipe(TINY, drapes, data), tmp_path / "stopped")
    assert resumed.resume()
    assert 0 < resumed.step < TINY.steps
    train(resumed, lambda step, figures: None)
    for name, value in whole.optimizer.averaged.state_dict().items():
        assert torch.equal(resumed.optimizer.averaged.state_dict()[name], value), name
    assert resumed.best == whole.best < math.inf
    logs = [rows_of(tmp_path / run / "validation.csv") for run in ("stopped", "whole")]
    for row in (*logs[0], *logs[1]):
        row.pop("seconds")
    assert logs[0] == logs[1]
    assert [row["step"] for row in rows_of(tmp_path / "whole/validation.csv")] == ["2", "4", "6"]
    other = Training(GroomGenRecipe(replace(TINY, seed=1), drapes, data), tmp_path / "stopped")
    with pytest.raises(InputError, match="seed 1"):
        other.resume()


def test_the_best_weights_are_kept(
    drapes: DrapeFolder, body: BodyModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    training = Training(GroomGenRecipe(TINY, drapes, drapes.read()), tmp_path / "run")
    for distance, step in ((2.0, 1), (1.0, 2), (1.5, 3)):
        training.step = step
        monkeypatch.setattr(training.recipe, "validate", lambda averaged, distance=distance: {"distance_mm": distance})
        training.validate()
    draper, notes = load_groomgen(tmp_path / "run/best.safetensors")
    assert (notes["step"], notes["groom"], notes["solver"]) == ("2", drapes.groom.name, "leaning")
    assert draper.knows(drapes.groom, body)


# ---- the draper


def test_a_drape_is_posed_plus_displacement_in_the_heads_frame(groom: Groom, body: BodyModel) -> None:
    network = network_of(groom, body)
    draper = GroomGenDraper(network, HairMaterial())
    scene = scene_of(groom, body, (0.2, 0.1, 0.4), (0.0, 0.0, -0.5))
    draped = draper.drape(scene)
    assert draped.shape == scene.posed.shape
    assert torch.equal(draped[:, :, 0], scene.posed[:, :, 0])
    head = scene.bodies.posed.joint_rotations[:, body.joint_names.index("Head")]
    in_head = (draped - scene.posed) @ head[:, None]
    expected = network(torch.tensor([[0.2, 0.1, 0.4], [0.0, 0.0, -0.5]])).detach()
    assert expected.abs().max() > 1e-3
    torch.testing.assert_close(in_head, expected, atol=1e-5, rtol=0)
    untrained = GroomGenNetwork(NARROW, head_strands(groom, body), texel_cells(groom))
    torch.testing.assert_close(GroomGenDraper(untrained, HairMaterial()).drape(scene), scene.posed)


def test_only_its_own_groom_is_draped(groom: Groom, body: BodyModel) -> None:
    draper = GroomGenDraper(network_of(groom, body), HairMaterial())
    turn = (0.2, 0.1, 0.4)
    whole = draper.drape(scene_of(groom, body, turn))
    some = torch.tensor([30, 2, 17])
    torch.testing.assert_close(draper.drape(scene_of(groom.select(some), body, turn)), whole[:, some])
    grown = replace(groom, rest_strands=groom.rest_strands + 1e-5)
    torch.testing.assert_close(draper.drape(scene_of(grown, body, turn)), whole, atol=1e-4, rtol=0)
    longer = replace(groom, rest_strands=groom.rest_strands * torch.tensor([1.0, 1.0, 0.99]))
    shifted = replace(groom, root_uv=(groom.root_uv + 0.2) % 1)
    for other in (longer, shifted):
        assert not draper.knows(other, body)
        with pytest.raises(InputError, match="expected the groom of 40 strands"):
            draper.drape(scene_of(other, body, turn))


def test_weights_come_back_from_a_file_and_damage_is_refused(groom: Groom, body: BodyModel, tmp_path: Path) -> None:
    network, material = network_of(groom, body), HairMaterial(k_cosserat=1e-7)
    path = tmp_path / "groomgen.safetensors"
    save_groomgen(path, network, material, {"made": "here"})
    draper, notes = load_groomgen(path)
    assert (draper.material, notes) == (material, {"made": "here"})
    assert draper.network.config == NARROW
    # Half precision holds the places of all strands.
    assert torch.equal(draper.network.texels, groom.texels())
    assert torch.equal(draper.network.rest_strands, network.rest_strands)
    turn = torch.tensor([[0.2, 0.1, 0.4]])
    torch.testing.assert_close(draper.network(turn), network(turn), atol=1e-4, rtol=0)
    narrower = GroomGenNetwork(replace(NARROW, strand_width=8), network.rest_strands, network.texel_cells)
    narrower.config = NARROW
    save_groomgen(path, narrower, material, {})
    with pytest.raises(InputError, match="weights of quaffure train-groomgen"):
        load_groomgen(path)
    network.texel_cells[3, 1] = 64
    save_groomgen(path, network, material, {})
    with pytest.raises(InputError, match="another groom's strands"):
        load_groomgen(path)


# ---- the commands


@pytest.mark.slow
def test_from_drapes_to_an_evaluation(
    groom: Groom, body: BodyModel, tmp_path: Path, refused: Callable[..., str], capfd: pytest.CaptureFixture[str]
) -> None:
    own, data, run = tmp_path / "own.npz", tmp_path / "data", tmp_path / "run"
    write_groom(own, replace(groom, name="own"))
    write_groom(
        tmp_path / "other.npz", replace(groom.select(torch.arange(5)), name="other", root_uv=groom.root_uv[5:10])
    )
    drape_some = ["groomgen-data", "--groom", str(own), "--out", str(data), "--poses", "4"]
    main([*drape_some, "--share", "2/2"])
    assert sorted(path.name for path in data.glob("pose*")) == ["pose_00001.npz", "pose_00003.npz"]
    before = (data / "pose_00001.npz").stat().st_mtime_ns
    main(drape_some)
    assert len(list(data.glob("pose*"))) == 4
    assert (data / "pose_00001.npz").stat().st_mtime_ns == before
    assert "2 of 4 poses of 40 strands left" in capfd.readouterr().out
    main(["train-groomgen", str(data), "--out", str(run), "--steps", "2", *OPTIONS])
    main(["train-groomgen", str(data), "--out", str(run), "--steps", "4", *OPTIONS])
    printed = capfd.readouterr().out
    assert "resuming from step 2" in printed
    assert "step 4 of 4" in printed
    weights = run / "best.safetensors"
    draped = tmp_path / "draped.npz"
    drape = ["drape", str(own), "--draper", "groomgen", "--frames", "0:2", "--out", str(draped)]
    main([*drape, "--weights", str(weights)])
    assert json.loads(str(np.load(draped)["meta"]))["draper"] == "groomgen"
    assert "--weights" in refused(*drape)
    assert "--settle" in refused(*drape, "--weights", weights, "--settle", "-2")
    assert "--elastic" in refused(*drape, "--weights", weights, "--elastic", "cosserat")
    assert "expected weights of quaffure train-groomgen" in refused(*drape, "--weights", own)
    assert "expected a checkpoint of this package" in refused(*drape, "--weights", weights, "--draper", "neural")

    out = tmp_path / "results.json"
    cases = ("--motion", "neck_turn", "--frames", "30:31", "--cache", tmp_path / "cache", "--out", out)
    rows = ("--draper", "groomgen", "--weights", f"groomgen={weights}")
    both = ("--groom", own, "--groom", tmp_path / "other.npz")
    main(["evaluate", *map(str, (*cases, *rows, "--draper", "posed", *both))])
    assert "groomgen left out of 1 of 2 cases" in capfd.readouterr().out
    results = json.loads(out.read_text())
    assert [sorted(case["figures"]) for case in results["cases"]] == [["groomgen", "posed"], ["posed"]]
    assert results["rows"]["groomgen"]["weights"]["solver"] == "xpbd"
    assert results["cases"][0]["figures"]["groomgen"]["length_error_percent"][0] > 0.01
    out.unlink()
    assert "none of groomgen" in refused("evaluate", *cases, *rows, "--groom", tmp_path / "other.npz")
    assert not out.exists()
    assert "--weights groomgen=FILE" in refused("evaluate", *cases, "--draper", "groomgen", "--groom", own)


def test_hair_of_another_kind_is_no_row(groom: Groom, body: BodyModel, tmp_path: Path) -> None:
    path = tmp_path / "stiff.safetensors"
    save_groomgen(path, network_of(groom, body), HairMaterial(k_cosserat=1.0), {})
    with pytest.raises(InputError, match="weights for hair of"):
        methods(("posed",), {"groomgen": path})


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["--groom", HELD_OUT[0]], "held out"),
        (["--groom", "bob", "--poses", "0"], "--poses: expected 1 or more"),
        (["--groom", "bob", "--seed", "-1"], "--seed: expected 0 or more"),
        (["--groom", "bob", "--share", "3/2"], "--share: expected I/N"),
        (["--groom", "bob", "--share", "half"], "--share: expected I/N"),
        (["--groom", "bob", "--draper", "magic"], "'magic'"),
        (["--groom", "magic"], "magic"),
    ],
)
def test_what_cannot_be_draped_is_refused_in_one_line(
    options: list[str], complaint: str, tmp_path: Path, refused: Callable[..., str]
) -> None:
    assert complaint in refused("groomgen-data", "--out", tmp_path / "data", *options)
    assert not (tmp_path / "data").exists()


def test_what_cannot_be_trained_is_refused_in_one_line(tmp_path: Path, refused: Callable[..., str]) -> None:
    assert "manifest" in refused("train-groomgen", tmp_path, "--out", tmp_path / "run")
    assert "strand_width from 1" in refused("train-groomgen", tmp_path, "--out", tmp_path, "--strand-width", "0")
    assert "--batch" in refused("train-groomgen", tmp_path, "--out", tmp_path, "--batch", "0")
