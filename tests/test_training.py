import json
from collections.abc import Iterable
from dataclasses import fields, replace
from itertools import islice
from pathlib import Path
from typing import Literal
from weakref import WeakSet

import pytest
import torch

from quaffure import HairMaterial, InputError
from quaffure.body import BodyModel, Motion, bundled_clip, load_body, load_pose_prior
from quaffure.energies import STANDARD_LOADING, HairEnergy, Loading, force_limit
from quaffure.hair import Groom
from quaffure.model import InitialShapeConfig, NeuralDraper, ProjectionConfig, build_network, load_network, save_network
from quaffure.model.network_config import DensityGridConfig
from quaffure.procedural import make_groom
from quaffure.scene import BodyBatch, Scene
from quaffure.training import (
    PoseSampler,
    TrainConfig,
    Worker,
    loss_unit,
    run_folder,
    train,
    train_decoder,
    validation_metrics,
)
from tests.scenes import sphere_groom
from tests.training_runs import TINY, perturbed, rows_of, tiny_groom, training


@pytest.fixture(scope="module")
def groom(body: BodyModel) -> Groom:
    return tiny_groom(body)


def silent(step: int, figures: dict[str, float]) -> None:
    pass


class SamePoses(PoseSampler):
    """Two frames of a turning head, every time."""

    def sample(self, runs: int, frames: int, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        pose = bundled_clip("neck_turn", load_body()).body_pose[[20, 65]]
        return pose.repeat(runs, 1), torch.zeros(2 * runs, 10)


@pytest.mark.parametrize("output", ["directions", "displacement"])
def test_steps_on_the_same_poses_lower_the_loss(body: BodyModel, tmp_path: Path, output: str) -> None:
    groom = make_groom("long_straight", body).select(torch.arange(0, 2400, 60))
    network = replace(TINY.network, output=output)
    elastic: Literal["rod", "modified_cosserat"] = "rod" if output == "directions" else "modified_cosserat"
    config = replace(TINY, network=network, elastic=elastic, steps=24, log_every=24, learning_rate=2e-3)
    run = training(body, groom, tmp_path, config, sampler=SamePoses(load_pose_prior()))
    losses = [figures["loss"] for figures in islice(run.steps(), 12)]
    # Slid strands start near the minimum: their loss begins at about nothing and ends below it.
    aim = losses[0] - 0.02 if output == "directions" else 0.8 * losses[0]
    assert losses[0] > (-0.02 if output == "directions" else 0)
    assert min(losses[-5:]) < aim


def test_two_runs_end_with_the_same_bits(body: BodyModel, groom: Groom, tmp_path: Path) -> None:
    weights = []
    for seed in (0, 0, 1):
        run = training(body, groom, tmp_path, replace(TINY, steps=2, seed=seed))
        for _ in run.steps():
            pass
        weights.append(run.recipe.network.state_dict())
    for name, value in weights[0].items():
        assert torch.equal(weights[1][name], value), name
    assert any(not torch.equal(weights[2][name], value) for name, value in weights[0].items())


def test_a_run_leaves_configuration_logs_and_the_best_weights(body: BodyModel, groom: Groom, tmp_path: Path) -> None:
    reports: list[dict[str, float]] = []
    train(training(body, groom, tmp_path), lambda step, figures: reports.append(figures))
    _, material, notes = load_network(tmp_path / "best.safetensors")
    assert material == TINY.material
    assert notes["grooms"] == "bob"
    assert {path.name for path in tmp_path.iterdir()} == {
        "best.safetensors", "checkpoint.pt", "config.json", "last.safetensors", "training.csv", "validation.csv"
    }  # fmt: skip
    rows = rows_of(tmp_path / "validation.csv")
    assert [row["step"] for row in rows] == ["2", "4"]
    assert float(rows[1]["body_intersection_percent"]) == pytest.approx(
        reports[3]["body_intersection_percent"], rel=1e-5
    )
    config = json.loads((tmp_path / "config.json").read_text())
    assert config["config"]["network"]["strand_width"] == 16
    assert config["grooms"] == [{"name": "bob", "strands": 40}]


@pytest.mark.slow
def test_the_log_holds_every_term_of_the_loss(body: BodyModel, groom: Groom, tmp_path: Path) -> None:
    train(training(body, groom, tmp_path, replace(TINY, log_every=2)), silent)
    first, *rows = rows_of(tmp_path / "training.csv")
    assert [row["step"] for row in rows] == ["2", "4"]
    assert first["step"] == "1"
    terms = ("elastic", "stretch", "gravity", "body_collision", "self_collision", "pose_regularization")
    for row in (first, *rows):
        values = [float(row[name]) for name in terms]
        # Strands that slide along the body from the start may touch nothing.
        assert all(value != 0 for name, value in zip(terms, values) if name != "body_collision")
        assert sum(values) == pytest.approx(float(row["loss"]), rel=1e-4)
    assert float(rows[0]["learning_rate"]) > float(rows[1]["learning_rate"]) > 0


def test_validation_tells_the_share_of_vertices_inside(body: BodyModel, groom: Groom) -> None:
    class QuarterInside(NeuralDraper):
        """Strands a hundredth of their size: every fourth one in the middle of the head, the others above it."""

        def drape(self, scene: Scene) -> torch.Tensor:
            head = scene.bodies.posed.joint_positions[:, body.joint_names.index("Head"), None, None]
            places = torch.tensor([0.0, -0.02, 0.1]).repeat(len(groom), 1, 1)
            places[torch.arange(len(groom)) % 4 > 0] += torch.tensor([0.0, 0.0, 1.0])
            return head + places + 0.01 * (scene.posed - scene.posed[:, :, :1])

    scene = Scene(groom, BodyBatch(body, torch.zeros(1, 81), torch.zeros(1, 10)))
    draper = QuarterInside(build_network(TINY.network), HairMaterial())
    figures = validation_metrics(draper, [(scene, HairEnergy(groom, HairMaterial()))])
    assert figures["body_intersection_percent"] == pytest.approx(25)
    assert figures["length_error_percent"] == pytest.approx(99, abs=0.1)
    assert figures["orientation_error_deg"] < 0.1


def test_stubble_is_measured_by_what_a_bend_costs() -> None:
    material = HairMaterial(k_cosserat=3e-4)
    groom = sphere_groom(strands=5)
    energy = HairEnergy(groom, material)
    weight = 9.81 * float((energy.rest.mass * groom.strand_lengths[:, None]).sum())
    assert loss_unit(energy) == pytest.approx(weight + 0.1 * 5 * 24 * 3e-4, rel=1e-5)
    assert 0.1 * weight < 5 * 24 * 3e-4


@pytest.mark.parametrize("largest_force", [10.0, 0.01])
def test_the_mean_loss_of_several_grooms_is_followed(
    body: BodyModel, groom: Groom, tmp_path: Path, largest_force: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same groom twice is the groom, also where every force is cut off."""
    monkeypatch.setattr(force_limit, "MAX_FORCE", largest_force)
    monkeypatch.setattr(train_decoder, "draw_loading", lambda generator: STANDARD_LOADING)
    config = replace(TINY, steps=1, grooms_per_step=2)
    alone, twice = (
        next(training(body, grooms, tmp_path, config, sampler=SamePoses(load_pose_prior())).steps())
        for grooms in ((groom,), (groom, groom))
    )
    for name in ("loss", "gradient_norm", "self_collision"):
        assert twice[name] == pytest.approx(alone[name], rel=1e-3), name


@pytest.mark.slow
def test_some_of_many_grooms_are_drawn_anew_for_every_step(body: BodyModel, groom: Groom, tmp_path: Path) -> None:
    grooms = tuple(replace(groom, name=name) for name in "abc")
    config = replace(TINY, steps=8, runs=1, grooms_per_step=2, log_every=100)
    run = training(body, grooms, tmp_path, config, sampler=SamePoses(load_pose_prior()))
    assert run.recipe.samples_per_step == 4
    drawn: list[str] = []
    own_objective = run.recipe._objective

    def recording(
        scene: Scene, energy: HairEnergy, loading: Loading, count: int, step: int
    ) -> tuple[torch.Tensor, dict[str, float]]:
        drawn.append(scene.groom.name)
        assert count == 2
        return own_objective(scene, energy, loading, count, step)

    run.recipe._objective = recording  # type: ignore[method-assign]
    for _ in run.steps():
        pass
    pairs = {frozenset(pair) for pair in zip(drawn[::2], drawn[1::2], strict=True)}
    assert len(drawn) == 16
    assert all(len(pair) == 2 for pair in pairs)
    assert len(pairs) > 1
    assert set(drawn) == set("abc")


def test_a_sample_counts_by_the_logarithm_of_its_energy(
    body: BodyModel, groom: Groom, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(train_decoder, "clip_gradients", lambda positions, rest, joules: None)
    scene = Scene(groom, BodyBatch(body, *PoseSampler(load_pose_prior()).sample(2, 1, torch.Generator())))
    recipe = training(body, groom, tmp_path, replace(TINY, runs=2, frames=1)).recipe
    perturbed(recipe.network)
    energy, weight = recipe.energies[0], recipe.network.strand[-1].weight
    objective, _ = recipe._objective(scene, energy, STANDARD_LOADING, 1, 0)
    (gradient,) = torch.autograd.grad(objective, weight)
    total = energy.total(recipe.draper.deform(scene, projects=True), scene)
    (expected,) = torch.autograd.grad((total / loss_unit(energy) + 2.0).log().mean(), weight)
    assert total.detach().amax() > 1.5 * total.detach().amin()
    torch.testing.assert_close(gradient, expected, rtol=1e-3, atol=1e-4 * float(expected.norm()))


@pytest.mark.parametrize("elastic", ["cosserat", "mass_spring"])
def test_the_loss_holds_strands_together_with_the_elastic_model_that_is_asked_for(
    body: BodyModel, groom: Groom, tmp_path: Path, elastic: Literal["cosserat", "mass_spring"]
) -> None:
    # Strands whose bends have spread are hardly stretched, sheared or bent before the first step.
    network = replace(TINY.network, initial_shape=InitialShapeConfig(bend_relaxation=0.0, margin_slope=0.6))
    config = replace(TINY, elastic=elastic, steps=1, network=network)
    run = training(body, groom, tmp_path, config)
    train(run, silent)
    terms = {name: float(value) for name, value in rows_of(tmp_path / "training.csv")[0].items()}
    assert terms["elastic"] > 1e-4
    parts = ("elastic", "gravity", "body_collision", "self_collision", "pose_regularization")
    assert terms["loss"] == pytest.approx(sum(terms[name] for name in parts), abs=2e-5)
    assert load_network(tmp_path / "best.safetensors")[2]["elastic"] == elastic
    with pytest.raises(InputError, match="a run of"):
        training(body, groom, tmp_path, replace(config, elastic="modified_cosserat")).resume()


def test_the_best_weights_are_those_of_the_lowest_loss(
    body: BodyModel, groom: Groom, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    figures = iter([{"log_energy": 1.0}, {"log_energy": 0.8}, {"log_energy": 0.9}])
    monkeypatch.setattr(train_decoder, "validation_metrics", lambda draper, scenes: next(figures))
    run = training(body, groom, tmp_path, replace(TINY))
    for run.step in (1, 2, 3):
        run.validate()
    assert load_network(tmp_path / "best.safetensors")[2]["step"] == "2"


def test_some_of_many_grooms_stand_for_all_in_a_validation(
    body: BodyModel, groom: Groom, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    measured: list[tuple[int, int]] = []
    kept: WeakSet[Scene] = WeakSet()

    def figures(draper: NeuralDraper, scenes: Iterable[tuple[Scene, HairEnergy]]) -> dict[str, float]:
        for scene, energy in scenes:
            measured.append((len(scene.groom), len(energy.rest.mass)))
            kept.add(scene)
            assert len(kept) == 1
        return {"log_energy": 0.0, "body_collision": 0.0}

    monkeypatch.setattr(train_decoder, "VALIDATED_GROOMS", 2)
    monkeypatch.setattr(train_decoder, "validation_metrics", figures)
    grooms = tuple(groom.select(torch.arange(count)) for count in (10, 11, 12, 13, 14))
    training(body, grooms, tmp_path, sampler=SamePoses(load_pose_prior())).validate()
    assert measured == [(10, 10), (13, 13)]


def test_a_body_is_hashed_once_for_all_its_grooms(
    body: BodyModel, groom: Groom, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hashed: list[BodyModel] = []

    def digest(hashed_body: BodyModel) -> str:
        hashed.append(hashed_body)
        return "0123"

    monkeypatch.setattr(train_decoder, "body_digest", digest)
    recipe = training(body, (groom, replace(groom, name="other")), tmp_path).recipe
    assert recipe.identity()["geometry"].startswith("body 0123, strands")
    assert len(hashed) == 1


def test_the_version_of_the_code_is_that_of_the_start(
    body: BodyModel, groom: Groom, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    versions = iter(["at the start", "edited since"])
    monkeypatch.setattr(run_folder, "code_version", lambda: next(versions))
    run = training(body, groom, tmp_path)
    run.folder.describe(run.recipe.description())
    run.validate()
    assert json.loads((tmp_path / "config.json").read_text())["version"] == "at the start"
    assert load_network(tmp_path / "best.safetensors")[2]["version"] == "at the start"


def test_a_run_killed_before_its_first_checkpoint_begins_its_logs_anew(
    body: BodyModel, groom: Groom, tmp_path: Path
) -> None:
    killed = training(body, groom, tmp_path)
    for figures in islice(killed.steps(), 3):
        killed.log(figures)
    again = training(body, groom, tmp_path)
    assert not again.resume()
    train(again, silent)
    assert [row["step"] for row in rows_of(tmp_path / "training.csv")] == ["1", "2", "3", "4"]


def test_the_regularization_of_poses_reaches_the_network(body: BodyModel, groom: Groom, tmp_path: Path) -> None:
    losses = []
    for strength in (0.0, 10.0):
        material = replace(TINY.material, k_pose_reg=strength)
        losses.append(next(training(body, groom, tmp_path, replace(TINY, material=material)).steps())["loss"])
    assert losses[1] > losses[0] + 1e-6


def test_runs_are_consecutive_frames_of_one_body() -> None:
    clip = Motion(torch.arange(20.0)[:, None].expand(-1, 81) / 100, 30.0, "count")
    sampler = PoseSampler(load_pose_prior(), (clip,), clip_share=1.0)
    pose, shape = sampler.sample(5, 3, torch.Generator().manual_seed(0))
    steps = pose.reshape(5, 3, 81).diff(dim=1)
    torch.testing.assert_close(steps, torch.full_like(steps, 0.01), atol=1e-6, rtol=0)
    assert len({round(float(start), 3) for start in pose[::3, 0]}) > 1
    assert torch.equal(shape[0], shape[2])
    assert not torch.equal(shape[0], shape[3])


def test_weights_to_start_from_are_those_of_both_networks(body: BodyModel, groom: Groom, tmp_path: Path) -> None:
    run = training(body, groom, tmp_path, replace(TINY, learning_rate=1e-9))
    given = build_network(TINY.network)
    run.start_from(given)
    next(run.steps())
    for network in (run.recipe.network, run.optimizer.averaged):
        for name, value in given.state_dict().items():
            torch.testing.assert_close(network.state_dict()[name], value, atol=1e-7, rtol=1e-5)
    with pytest.raises(InputError, match="other layers"):
        run.start_from(build_network(replace(TINY.network, strand_width=8)))


def test_a_folder_of_another_run_is_refused(body: BodyModel, groom: Groom, tmp_path: Path) -> None:
    training(body, groom, tmp_path).save()
    with pytest.raises(InputError, match="seed 1"):
        training(body, groom, tmp_path, replace(TINY, seed=1)).resume()
    with pytest.raises(InputError, match=r"strands \[20\]"):
        training(body, groom.select(torch.arange(20)), tmp_path).resume()
    other = torch.load(tmp_path / "checkpoint.pt", weights_only=True)
    other["network"]["of_another_version"] = torch.zeros(1)
    torch.save(other, tmp_path / "checkpoint.pt")
    with pytest.raises(InputError, match="checkpoint of this training"):
        training(body, groom, tmp_path).resume()


def test_a_run_goes_on_after_a_gradient_that_is_not_finite(
    body: BodyModel, groom: Groom, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = training(body, groom, tmp_path, replace(TINY, validate_every=100))
    own_objective = run.recipe._objective

    def broken_once(
        scene: Scene, energy: HairEnergy, loading: Loading, grooms: int, step: int
    ) -> tuple[torch.Tensor, dict[str, float]]:
        objective, metrics = own_objective(scene, energy, loading, grooms, step)
        nan = float("nan")
        return (nan * objective, metrics | {"loss": nan}) if step == 1 else (objective, metrics)

    monkeypatch.setattr(run.recipe, "_objective", broken_once)
    train(run, silent)
    rows = rows_of(tmp_path / "training.csv")
    assert [row["step"] for row in rows] == ["1", "2", "3", "4"]
    assert [float(row["skipped_updates"]) for row in rows] == [0, 1, 1, 1]
    assert [row["loss"] == "nan" for row in rows] == [False, True, False, False]
    again = training(body, groom, tmp_path)
    assert again.resume()
    assert (again.step, again.optimizer.skipped) == (4, 1)


def test_impossible_networks_are_refused(tmp_path: Path) -> None:
    for wrong in ({"strand_layers": 0}, {"strand_layers": 65}, {"strand_width": 0}, {"texel_channels": 5000}):
        with pytest.raises(ValueError, match=f"expected {next(iter(wrong))} from"):
            replace(TINY.network, **wrong)
    network = build_network(replace(TINY.network, strand_layers=1))
    save_network(tmp_path / "n.safetensors", network, HairMaterial(), {})
    assert load_network(tmp_path / "n.safetensors")[0].config.strand_layers == 1
    for value in (float("nan"), float("inf"), -float("inf")):
        torch.nn.init.constant_(network.decoder.dense[0].bias, value)
        save_network(tmp_path / "n.safetensors", network, HairMaterial(), {})
        with pytest.raises(InputError, match="finite weights"):
            load_network(tmp_path / "n.safetensors")


def test_settings_out_of_range_are_refused() -> None:
    nan = float("nan")
    for wrong, option in (
        ({"validate_every": 0}, "--validate-every"),
        ({"warmup": -1}, "--warmup"),
        ({"save_every_seconds": nan}, "--save-every-seconds"),
        ({"seed": 2**64}, "--seed"),
        ({"runs": 10**9}, "--runs and --frames"),
    ):
        with pytest.raises(InputError, match=f"^{option}: expected"):
            TrainConfig(**wrong)  # type: ignore[arg-type]
    for part in (InitialShapeConfig, ProjectionConfig, DensityGridConfig):
        for name in (field.name for field in fields(part) if field.type == "float" or field.type is float):
            for value in (nan, float("inf")):
                with pytest.raises(ValueError, match=f"expected a finite {name}, found"):
                    part(**{name: value})


@pytest.mark.cuda
def test_a_step_on_cuda_has_the_loss_of_one_on_the_cpu(body: BodyModel, groom: Groom, tmp_path: Path) -> None:
    losses = []
    for device in ("cpu", "cuda"):
        run = training(body, groom, tmp_path, worker=Worker(device=torch.device(device)))
        losses.append([figures["loss"] for figures in run.steps()])
    assert losses[1] == pytest.approx(losses[0], rel=1e-2)
