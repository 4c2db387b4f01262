import json
import re
import signal
import subprocess
import time
from dataclasses import replace
from importlib.resources import files
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from rich.console import Console

from quaffure import InputError, load_groom
from quaffure.apps.cli import console as cli_console
from quaffure.apps.cli import train as train_cli
from quaffure.apps.cli.console import progress_bar
from quaffure.apps.cli.main import main
from quaffure.benchmark import load_evaluation_set
from quaffure.benchmark.evaluation_set import SETS, refuse_evaluation_data
from quaffure.body import BodyModel, load_body
from quaffure.hair import Groom, root_positions
from quaffure.io import write_groom
from quaffure.io.body_file import write_body
from quaffure.model import load_model, load_network
from quaffure.procedural import HELD_OUT, STYLES
from quaffure.scene import Scene
from quaffure.training import DecoderRecipe, ProceduralGroom, loop, train, validation
from quaffure.training.stop_request import SIGNALS
from tests.characters import character
from tests.test_own_motion import own_body
from tests.training_runs import (
    LONGEST_WAIT,
    QUAFFURE,
    TINY,
    TINY_OPTIONS,
    checkpoint,
    rows_of,
    tiny_groom,
    train_command,
    training,
)


@pytest.fixture(scope="module")
def groom(body: BodyModel) -> Groom:
    return tiny_groom(body)


@pytest.mark.slow
def test_a_killed_run_ends_like_an_unbroken_one_bit_for_bit(tiny_groom_file: Path, tmp_path: Path) -> None:
    steps, killed = 6, tmp_path / "killed"
    process = subprocess.Popen([QUAFFURE, *train_command(killed, tiny_groom_file, steps)], stdout=subprocess.DEVNULL)
    log, end = killed / "training.csv", time.monotonic() + LONGEST_WAIT
    try:
        while not (log.is_file() and len(rows_of(log)) >= 2):
            assert process.poll() is None
            assert time.monotonic() < end
            time.sleep(0.01)
    finally:
        process.kill()
    assert process.wait() == -signal.SIGKILL
    reached = checkpoint(killed)["counters"][0]
    assert 1 <= reached < steps

    main(train_command(killed, tiny_groom_file, steps))
    main(train_command(tmp_path / "whole", tiny_groom_file, steps))
    resumed, whole = checkpoint(killed), checkpoint(tmp_path / "whole")
    for part in ("network", "average"):
        for name, value in whole[part].items():
            assert torch.equal(resumed[part][name], value), name
    assert torch.equal(resumed["counters"][:2], whole["counters"][:2])
    assert [row["loss"] for row in rows_of(log)] == [row["loss"] for row in rows_of(tmp_path / "whole/training.csv")]


@pytest.mark.slow
@pytest.mark.parametrize("number", SIGNALS)
def test_a_run_that_is_asked_to_stop_ends_its_step_and_leaves_weights(
    number: signal.Signals, tiny_groom_file: Path, tmp_path: Path
) -> None:
    """Long before its first validation."""
    folder, steps = tmp_path / "run", 100_000
    command = [QUAFFURE, *train_command(folder, tiny_groom_file, steps), "--save-every-seconds", "1e6"]
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(number, signal.SIG_DFL),  # `nohup` ignores SIGHUP, for all that it starts
    )
    log, end = folder / "training.csv", time.monotonic() + LONGEST_WAIT
    with process:
        try:
            while not (log.is_file() and len(rows_of(log)) >= 2):
                assert process.poll() is None
                assert time.monotonic() < end
                time.sleep(0.01)
            weights = folder / "last.safetensors"  # the first ones, where kernels had to be compiled
            before = weights.read_bytes() if weights.exists() else b""
            process.send_signal(number)
            printed, errors = process.communicate(timeout=LONGEST_WAIT)
        finally:
            process.kill()
    assert process.returncode == 128 + number
    assert errors == "stopping after this step; once more stops at once\n"
    reached = int(checkpoint(folder)["counters"][0])
    assert weights.read_bytes() != before
    network, _, notes = load_network(weights)
    assert int(notes["step"]) == reached >= 2
    average = checkpoint(folder)["average"]
    for name, value in network.state_dict().items():
        if name in average:
            assert torch.equal(average[name], value), name
    assert f"stopped at step {reached} of {steps}; the same command continues" in printed
    # Plain lines: this is no terminal.
    assert not {"\r", "\x1b", "━"} & set(printed)
    assert f"1 of {steps}, " in printed


def test_lines_in_place_of_a_bar_are_few() -> None:
    written = StringIO()
    to = Console(file=written, width=40)
    with progress_bar("draping", 900, 100, to=to, transient=True) as update:
        for _ in range(800):
            update(advance=1)
    assert re.fullmatch(r"101 of 900, \d+:\d\d:\d\d left: draping\n", written.getvalue())


def test_weights_come_within_the_first_minute(
    body: BodyModel, groom: Groom, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run whose checkpoints are far apart has its first one after `FIRST_SAVE_SECONDS`, and its first row at once."""
    monkeypatch.setattr(loop, "FIRST_SAVE_SECONDS", 0.0)
    saved: list[int] = []
    run = training(body, groom, tmp_path, replace(TINY, steps=4, log_every=50, validate_every=50))
    monkeypatch.setattr(run, "save", lambda: saved.append(run.step))
    train(run, lambda step, metrics: None)
    assert set(saved) == {1, 4}
    assert [row["step"] for row in rows_of(tmp_path / "training.csv")] == ["1"]


def test_a_run_from_the_shipped_weights_takes_their_network(
    tiny_groom_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(validation, "_POSES", 2)
    shipped = load_model().draper.network
    command = ["train", "--out", str(tmp_path / "run"), "--groom", str(tiny_groom_file), "--weights", "shipped"]
    small = ["--steps", "1", "--runs", "1", "--validate-every", "1", "--learning-rate", "1e-9"]
    main([*command, *small])
    trained, *_ = load_network(tmp_path / "run" / "best.safetensors")
    assert trained.config == shipped.config
    for name, value in shipped.state_dict().items():
        torch.testing.assert_close(trained.state_dict()[name], value, atol=1e-4, rtol=1e-2)
    with pytest.raises(SystemExit) as stop:
        main([*command, *small, "--texel-channels", "7"])
    assert stop.value.code == 2
    assert "the options of their network" in capsys.readouterr().err


@pytest.mark.slow
def test_the_command_trains_on_another_body(
    tiny_groom_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with np.load(str(files("quaffure") / "assets" / "body.npz"), allow_pickle=False) as shipped:
        arrays = dict(shipped)
    arrays["rest_vertices"] = arrays["rest_vertices"] + np.float32([0, 0, 1e-3])
    np.savez(tmp_path / "taller.npz", **arrays)
    command = train_command(tmp_path / "run", tiny_groom_file, 1)
    main([*command, "--body", str(tmp_path / "taller.npz")])
    load_network(tmp_path / "run" / "best.safetensors")
    with pytest.raises(SystemExit) as stop:
        main(command)
    assert stop.value.code == 2
    assert "expected a run of body" in capsys.readouterr().err

    arrays["joint_names"] = arrays["joint_names"][::-1]
    np.savez(tmp_path / "reversed.npz", **arrays)
    with pytest.raises(SystemExit):
        main([*command, "--body", str(tmp_path / "reversed.npz")])
    assert "the joints" in capsys.readouterr().err


@pytest.mark.slow
def test_every_groom_is_trained_on_each_body(
    body: BodyModel, tiny_groom_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Shapes are drawn for bodies that have some; the shape of a character is its own."""
    unshaped = {name: torch.zeros_like(getattr(body, name)) for name in ("shape_directions", "joint_shape_directions")}
    path, folder = tmp_path / "character.npz", tmp_path / "run"
    write_body(path, replace(own_body(character(body), body), **unshaped))
    draped: list[Scene] = []

    class Recorder(DecoderRecipe):
        def _objective(self, scene: Scene, *rest: Any) -> tuple[torch.Tensor, dict[str, float]]:
            draped.append(scene)
            return super()._objective(scene, *rest)

    monkeypatch.setattr(validation, "_POSES", 2)
    monkeypatch.setattr(train_cli, "DecoderRecipe", Recorder)
    main([*train_command(folder, tiny_groom_file, 1), "--body", "shipped", "--body", str(path)])
    ours, own = (scene.bodies for scene in draped)
    assert ours.body is body
    assert ours.body_shape.abs().min() > 0
    assert own.body.origin is not None
    assert not own.body_shape.any()
    torch.testing.assert_close(ours.body_pose, own.body_pose)
    geometry = json.loads((folder / "config.json").read_text())["geometry"]
    assert len(re.findall("[0-9a-f]{8}", geometry)) == 2


@pytest.mark.slow
def test_a_network_is_specialised_on_a_character(
    body: BodyModel,
    tiny_groom_file: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Grooms move to it, its shape is its own, and what it starts from is measured first, and best until beaten."""
    unshaped = {name: torch.zeros_like(getattr(body, name)) for name in ("shape_directions", "joint_shape_directions")}
    own = replace(own_body(character(body), body), **unshaped)
    path, folder = tmp_path / "character.npz", tmp_path / "run"
    write_body(path, own)
    made: list[DecoderRecipe] = []

    def recipe_of(*settings: Any) -> DecoderRecipe:
        made.append(DecoderRecipe(*settings))
        return made[0]

    class Few(ProceduralGroom):
        def groom(self, body: BodyModel) -> Groom:
            return replace(super().groom(body).thinned(40), name=self.name)

    few = Few("few", STYLES["bob"], 1)
    monkeypatch.setattr(train_cli, "family_grooms", lambda indices: [few])
    monkeypatch.setattr(validation, "_POSES", 2)
    monkeypatch.setattr(train_cli, "DecoderRecipe", recipe_of)
    options = ["--steps", "2", "--runs", "1", "--frames", "1", "--grooms-per-step", "1", "--validate-every", "2"]
    command = ["train", "--out", str(folder), "--groom", str(tiny_groom_file), "--family", "1", "--body", str(path)]
    main([*command, "--weights", "shipped", *options])
    (recipe,) = made
    assert [groom.name for groom in recipe.grooms] == ["bob", "few"]
    for groom in recipe.grooms:
        roots = root_positions(groom, own.rest_vertices[None], own)[0]
        torch.testing.assert_close(groom.rest_strands[:, 0], roots, atol=1e-5, rtol=0)
    assert all(body.origin is not None for body in recipe.bodies)
    printed = capsys.readouterr().out
    assert "before training: energy" in printed
    assert re.search(r"1 of 2, \d+:\d\d:\d\d left: loss", printed)
    assert [row["step"] for row in rows_of(folder / "validation.csv")] == ["0", "2"]
    specialised = load_model(folder / "best.safetensors").on(load_body(path))
    hair = specialised.drape(load_groom(tiny_groom_file, own), torch.zeros(1, 81))
    assert torch.isfinite(hair).all()


@pytest.mark.parametrize("in_hardware", [False, True])
def test_a_processor_without_bfloat16_is_told_of(
    tiny_groom_file: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    in_hardware: bool,
) -> None:
    monkeypatch.setattr(cli_console, "lacks_bfloat16", lambda: not in_hardware)
    main([*train_command(tmp_path / "run", tiny_groom_file, 1), "--bf16"])
    line = "this processor has no instructions for bfloat16: steps are faster without --bf16"
    assert (line in capsys.readouterr().out) == (not in_hardware)


def test_without_grooms_the_bundled_ones_are_trained_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, groom: Groom
) -> None:
    asked: list[str] = []
    runs: list[DecoderRecipe] = []
    monkeypatch.setattr(train_cli, "load_groom", lambda name, body: asked.append(name) or replace(groom, name=name))
    monkeypatch.setattr(train_cli, "run_training", lambda training, *texts, **options: runs.append(training.recipe))
    main(["train", "--out", str(tmp_path / "run"), *TINY_OPTIONS])
    assert set(asked) == set(STYLES) - set(HELD_OUT)
    assert [trained.name for trained in runs[0].grooms] == asked


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["--groom", HELD_OUT[0]], "held out"),
        (["--groom", "bob", "--groom", "mohawk/Ratboy_mohawk.tfx"], "held out"),
        (["--groom", "bob", "--motion", "nod"], "not in the evaluation set"),
        (["--groom", "bob", "--pose-features", "5"], "0 or 111"),
        (["--groom", "bob", "--weights", "none.safetensors"], "no such file"),
        (["--family", "-1"], "--family: expected 0 to 10000"),
        (["--groom", "bob", "--strand-layers", "0"], "strand_layers from 1 to 64"),
        (["--groom", "bob", "--learning-rate", "-1"], "--learning-rate: expected a number above 0"),
        (["--groom", "bob", "--seed", "-1"], "--seed: expected 0 or more"),
    ],
)
def test_what_cannot_be_trained_is_refused_in_one_line(
    options: list[str], complaint: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["train", "--out", str(tmp_path / "run"), "--steps", "1", *TINY_OPTIONS, *options])
    assert stop.value.code == 2
    errors = capsys.readouterr().err
    assert complaint in errors
    assert errors.count("\n") == 1


def test_a_held_out_groom_under_another_name_is_refused(
    groom: Groom, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_groom(tmp_path / "mine.npz", replace(groom, name=HELD_OUT[0]))
    with pytest.raises(SystemExit):
        main(train_command(tmp_path / "run", tmp_path / "mine.npz", 1))
    assert "held out" in capsys.readouterr().err


@pytest.mark.parametrize("version", SETS)
@pytest.mark.parametrize("spelling", ["{}", "somewhere/{}.npz", "somewhere/{}.tfx"])
def test_nothing_of_an_evaluation_set_is_trained_on(spelling: str, version: int) -> None:
    of = load_evaluation_set(version)
    unseen = [name for name, source in of.grooms.items() if source.group == "unseen"]
    unseen += [Path(source.file).stem for source in of.grooms.values() if source.group == "unseen" and source.file]
    assert {*HELD_OUT, *{2: ("ratboy_mohawk", "Ratboy_mohawk"), 3: ("sintel", "harolongo")}[version]} <= set(unseen)
    for name in (*unseen, *map(str.upper, unseen)):
        with pytest.raises(InputError, match="held out"):
            refuse_evaluation_data(grooms=["bob", spelling.format(name)])
    clips = {entry.clip for entry in of.cases}
    assert clips > {"nod", {2: "13_26", 3: "05_11"}[version]}
    for name in (*clips, *of.motions):
        with pytest.raises(InputError, match="evaluation set"):
            refuse_evaluation_data(motions=[Path("02_06.bvh"), Path(spelling.format(name))])
    seen = [name for name, source in of.grooms.items() if source.group in ("seen", "tied") and name != "sintel"]
    refuse_evaluation_data([spelling.format(name) for name in (*seen, "mohawk")], [spelling.format("02_06")])


@pytest.mark.slow
def test_validation_poses_are_from_no_clip(
    tiny_groom_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs: list[DecoderRecipe] = []
    monkeypatch.setattr(train_cli, "run_training", lambda training, *texts, **options: runs.append(training.recipe))
    poses = 0.1 * np.random.default_rng(0).standard_normal((40, 81))
    np.savez(tmp_path / "own.npz", body_pose=poses.astype(np.float32), fps=np.float32(30))
    command = train_command(tmp_path / "run", tiny_groom_file, 1)
    main(command)
    main([*command, "--motion", str(tmp_path / "own.npz"), "--family", "1"])
    without, trained = runs
    assert [clip.name for clip in trained.sampler.clips] == ["own"]
    assert [groom.name for groom in trained.grooms][1:] == ["family_0"]
    assert torch.equal(trained.validation.body_pose, without.validation.body_pose)
    assert torch.equal(trained.validation.body_shape, without.validation.body_shape)
