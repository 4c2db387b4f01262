import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from quaffure import InputError
from quaffure.apps.cli import train_code
from quaffure.apps.cli.main import main
from quaffure.benchmark.groom_code_metrics import (
    betweenness,
    code_metrics,
    codes_of,
    half_of,
    interpolation_metrics,
    reconstruction,
    scatter_of_styles,
    style_scatter,
)
from quaffure.body import BodyModel
from quaffure.geometry import Surface
from quaffure.hair import Groom, select_guides
from quaffure.io import write_groom
from quaffure.model import GroomAutoencoder, load_groom_autoencoder, load_groom_encoder, strands_from_features
from quaffure.model.groom_autoencoder import decoded_channels, relative_distance
from quaffure.model.groom_code import WEIGHTS, groom_code, save_autoencoder, save_encoder
from quaffure.model.groom_texture import (
    SHAPE_CHANNELS,
    GroomSample,
    groom_texture,
    root_frames,
    sample_of,
    strand_features,
)
from quaffure.procedural import HELD_OUT, STYLES, make_groom
from quaffure.training import GroomCodeConfig, GroomCodeRecipe, Training, train
from quaffure.training.groom_batches import batch_of, mean_strands, mirrored, part_of, patch_of, scaled
from quaffure.training.train_groom_code import finish
from tests.scenes import Registered

NARROW = (16, 16, 16, 16)
TINY = GroomCodeConfig(steps=6, batch=4, warmup=1, widths=NARROW, save_every_seconds=0)
STYLES_HERE = ("long_straight", "bob", "afro", HELD_OUT[0])


@pytest.fixture(scope="module")
def grooms(body: BodyModel, surface: Surface) -> dict[str, Groom]:
    return {name: make_groom(name, body) for name in STYLES_HERE}


@pytest.fixture(scope="module")
def anew(body: BodyModel, surface: Surface) -> dict[str, Groom]:
    return {name: make_groom(name, body, seed=77) for name in STYLES_HERE}


@pytest.fixture(scope="module")
def samples(body: BodyModel, grooms: dict[str, Groom]) -> list[GroomSample]:
    return [sample_of(groom, body, name) for name, groom in grooms.items()]


def test_root_frames_are_rotations_and_follow_the_chart(body: BodyModel, grooms: dict[str, Groom]) -> None:
    frames = root_frames(grooms["bob"], body)
    assert torch.allclose(frames.mT @ frames, torch.eye(3).expand_as(frames), atol=1e-5)
    assert torch.allclose(torch.linalg.det(frames), torch.ones(len(frames)), atol=1e-5)
    # u runs from the body's right to its left, v from forehead to nape; the body faces -y.
    roots, head = grooms["bob"].rest_strands[:, 0], body.rest_joints[body.joint_names.index("Head")]
    crown = (roots[:, 2] > head[2] + 0.14) & (roots[:, 0].abs() < 0.03)
    assert crown.sum() > 20
    assert frames[crown].diagonal(dim1=1, dim2=2).min() > 0.6
    outwards = ((roots - roots.mean(0)) * frames[..., 2]).sum(-1)
    assert (outwards > 0).float().mean() > 0.95


def test_neighbours_that_grow_alike_look_alike(body: BodyModel, grooms: dict[str, Groom]) -> None:
    afro = grooms["afro"]
    directions = torch.nn.functional.normalize(strand_features(afro, body)[:, 3 * 12 : 3 * 13], dim=-1)
    near = torch.cdist(afro.root_uv, afro.root_uv).fill_diagonal_(9).argmin(1)
    # In frames that turned by any angle from triangle to triangle, tangential parts would have no common direction.
    tangential = directions[:, :2]
    assert (tangential * tangential[near]).sum() / tangential.square().sum() > 0.5


def test_features_come_back_as_strands(body: BodyModel, grooms: dict[str, Groom]) -> None:
    for groom in grooms.values():
        features = strand_features(groom, body)
        assert torch.allclose(strands_from_features(features, groom, body), groom.rest_strands, atol=1e-5)
        assert torch.allclose(0.1 * features[:, SHAPE_CHANNELS].exp(), groom.strand_lengths, rtol=1e-4)
        assert (features[:, -1] == 1).all()


def test_a_groom_and_its_mirror_image(body: BodyModel, grooms: dict[str, Groom]) -> None:
    """Hair mirrored in the world is the mirrored texture, up to the asymmetry of the mean body."""
    texture = groom_texture(grooms["long_straight"], body)[0]
    image = mirrored(sample_of(grooms["long_straight"], body, ""))
    other = batch_of([image], [image]).textures[0]
    both = (texture[-1] > 0) & (other[-1] > 0)
    assert both.sum() > 1000
    assert torch.equal(other[-1], texture[-1].flip(1))
    gap = (texture - other)[:SHAPE_CHANNELS, both].abs().mean()
    unflipped = texture.flip(2)
    assert gap < 0.6 * (texture - unflipped)[:SHAPE_CHANNELS, both & (unflipped[-1] > 0)].abs().mean()
    assert torch.equal(mirrored(image).texels, sample_of(grooms["long_straight"], body, "").texels)


def test_a_perfect_answer_has_no_distance_and_a_short_one_its_share(samples: list[GroomSample]) -> None:
    features = samples[0].features.float()
    network = GroomAutoencoder(NARROW)
    with torch.no_grad():
        torch.nn.init.zeros_(network.decoder.texture.to_texels[0].weight)
        network.decoder.mean[samples[0].texels] = decoded_channels(features)
        decoded = network.decoder(torch.zeros(1, 16), torch.zeros_like(samples[0].texels), samples[0].texels)
    assert relative_distance(decoded, features).max() < 1e-3
    decoded[:, SHAPE_CHANNELS] += np.log(0.9)
    shape = features[:, 3:SHAPE_CHANNELS].unflatten(1, (-1, 3)).norm(dim=-1)
    assert torch.allclose(relative_distance(decoded, features), 0.1 * shape, atol=1e-3)


def test_figures_are_in_millimetres_and_percent(samples: list[GroomSample]) -> None:
    """Strands straight out of the skin, decoded as if 10 % shorter."""
    texels = samples[0].texels
    features = torch.zeros(len(texels), samples[0].features.shape[1])
    features[:, 2:SHAPE_CHANNELS:3] = torch.arange(24) / 23
    features[:, SHAPE_CHANNELS], features[:, -1] = np.log(0.2 / 0.1), 1
    network = GroomAutoencoder(NARROW)
    with torch.no_grad():
        torch.nn.init.zeros_(network.decoder.texture.to_texels[0].weight)
        network.decoder.mean[:] = decoded_channels(features)[0]
        network.decoder.mean[:, 0] += np.log(0.9)
    row = reconstruction(network, GroomSample("spikes", features.half(), texels))
    share = 0.1 * np.mean(np.arange(1, 24) / 23)
    assert row["length_mm"] == pytest.approx(200, rel=1e-3)
    assert row["mean_mm"] == pytest.approx(200 * share, rel=1e-2)
    assert row["length_percent"] == pytest.approx(100 * share, rel=1e-2)
    assert row["strand_percent"] == pytest.approx(100 * share, rel=1e-2)
    assert row["p95_mm"] == pytest.approx(20, rel=0.05)


def test_standardised_codes_decode_the_same(samples: list[GroomSample]) -> None:
    network = GroomAutoencoder(NARROW)
    batch = batch_of(samples, samples)
    with torch.no_grad():
        before = network.decoder(network.encoder(batch.textures), batch.samples, batch.texels)
        network.standardise(network.encoder(batch.textures))
        codes = network.encoder(batch.textures)
        after = network.decoder(codes, batch.samples, batch.texels)
    assert torch.allclose(after, before, atol=1e-3)
    assert torch.allclose(codes.std(0), torch.ones(16), atol=1e-2)
    assert codes.mean(0).abs().max() < 1e-2


def test_the_code_of_one_groom_is_moved_and_not_scaled(samples: list[GroomSample]) -> None:
    network = GroomAutoencoder(NARROW)
    textures = batch_of(samples, samples).textures[:1]
    with torch.no_grad():
        network.standardise(network.encoder(textures))
        code = network.encoder(textures)
    assert code.abs().max() < 1e-4


def test_the_mean_of_one_groom_is_that_groom(samples: list[GroomSample]) -> None:
    mean = mean_strands(samples[:1])
    own = decoded_channels(samples[0].features.float())
    assert torch.allclose(mean[samples[0].texels], own, atol=1e-5)
    assert (mean.norm(dim=1) > 0).all()


def test_parts_and_lengths_of_samples(samples: list[GroomSample]) -> None:
    generator = torch.Generator().manual_seed(0)
    part = part_of(samples[0], 0.3, generator)
    assert 0.2 < len(part.texels) / len(samples[0].texels) < 0.4
    assert len(part_of(samples[0], 0.0, generator).texels) == 1
    patch = patch_of(samples[0], torch.tensor([0.25, 0.5]), torch.tensor([0.5, 0.75]))
    assert len(patch.texels) > 100
    assert ((patch.texels % 64 >= 16) & (patch.texels % 64 < 32)).all()
    assert ((patch.texels // 64 >= 32) & (patch.texels // 64 < 48)).all()
    longer = scaled(samples[0], 2.0).features - samples[0].features
    assert torch.allclose(longer[:, SHAPE_CHANNELS].float(), torch.tensor(2.0).log(), atol=2e-3)
    assert (longer[:, :SHAPE_CHANNELS] == 0).all()


def test_training_lowers_the_loss(samples: list[GroomSample], tmp_path: Path) -> None:
    training = Training(GroomCodeRecipe(replace(TINY, steps=40, learning_rate=3e-3), samples[::2], []), tmp_path)
    losses = [metrics["loss"] for metrics in training.steps()]
    assert np.mean(losses[-8:]) < 0.8 * np.mean(losses[:8])


@pytest.mark.slow
def test_a_stopped_run_ends_like_an_unbroken_one(samples: list[GroomSample], tmp_path: Path) -> None:
    library, family = samples[:3], samples[3:]
    (tmp_path / "broken").mkdir()
    steps: list[int] = []
    unbroken = Training(GroomCodeRecipe(TINY, library, family), tmp_path)
    train(unbroken, lambda step, metrics: steps.append(step))
    whole = finish(unbroken)
    assert steps == [*range(1, 7)]
    first = Training(GroomCodeRecipe(TINY, library, family), tmp_path / "broken")
    assert not first.resume()
    for _ in zip(range(3), first.steps()):
        pass
    first.save()
    second = Training(GroomCodeRecipe(TINY, library, family), tmp_path / "broken")
    assert second.resume()
    assert second.step == 3
    train(second, lambda step, metrics: None)
    resumed = finish(second)
    for name, value in whole.state_dict().items():
        assert torch.allclose(value, resumed.state_dict()[name], atol=1e-6), name


def test_a_checkpoint_of_an_older_version_is_resumed(samples: list[GroomSample], tmp_path: Path) -> None:
    """Then the step was a number of its own, and nothing else was counted."""
    run = Training(GroomCodeRecipe(TINY, samples, []), tmp_path)
    next(run.steps())
    run.save()
    state = torch.load(tmp_path / "checkpoint.pt", weights_only=True)
    del state["counters"]
    torch.save(state | {"step": 1}, tmp_path / "checkpoint.pt")
    again = Training(GroomCodeRecipe(TINY, samples, []), tmp_path)
    assert again.resume()
    assert (again.step, again.best) == (1, float("inf"))


def test_a_run_leaves_the_encoder_with_and_without_its_decoder(samples: list[GroomSample], tmp_path: Path) -> None:
    network = finish(Training(GroomCodeRecipe(TINY, samples, []), tmp_path))
    codes = codes_of(network.encoder, samples)
    assert torch.allclose(codes.std(0), torch.ones(16), atol=1e-2)
    read = load_groom_autoencoder(tmp_path / "groom_autoencoder.safetensors")
    kept = load_groom_encoder(tmp_path / "groom_code.safetensors")
    assert torch.equal(codes_of(read.encoder, samples), codes_of(kept, samples))
    assert torch.allclose(codes_of(kept, samples), codes, atol=2e-2)


@pytest.mark.slow
def test_a_decoder_trained_on_leaves_all_codes_as_they_are(samples: list[GroomSample], tmp_path: Path) -> None:
    finish(Training(GroomCodeRecipe(TINY, samples, []), tmp_path))
    begun = load_groom_autoencoder(tmp_path / "groom_autoencoder.safetensors")
    training = Training(GroomCodeRecipe(TINY, samples[:3], [], begun), tmp_path / "on")
    train(training, lambda step, metrics: None)
    finished = finish(training)
    kept = finished.encoder.state_dict()
    assert all(torch.equal(kept[name], value) for name, value in begun.encoder.state_dict().items())
    assert not torch.equal(finished.decoder.texture.dense[0].weight, begun.decoder.texture.dense[0].weight)
    other = replace(TINY, widths=(32, 32, 32, 32))
    with pytest.raises(InputError, match="as the decoder to be trained on"):
        GroomCodeRecipe(other, samples[:3], [], begun)


@pytest.mark.slow
def test_the_command_grows_trains_and_measures(
    grooms: dict[str, Groom], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    trained = ["bob", "afro"]
    few = {name: STYLES[name] for name in (*trained, HELD_OUT[0])}
    for name, value in {
        "STYLES": few,
        "TRAINED": trained,
        "NEW_SEEDS": range(50, 51),
        "UNSEEN_SAMPLES": range(1),
    }.items():
        monkeypatch.setattr(train_code, name, value)
    write_groom(tmp_path / "own.npz", replace(grooms["afro"], name="bob"))
    own, run = str(tmp_path / "own.npz"), str(tmp_path / "run")
    sizes = {"steps": 2, "batch": 2, "library-seeds": 1, "family": 1}
    options = [f"--{name}={value}" for name, value in sizes.items()] + ["--widths", *["16"] * 4, "--json"]
    main(["train-code", "--out", run, "--groom", own, "--unseen", own, *options])
    figures = json.loads(capsys.readouterr().out)
    assert figures == json.loads((tmp_path / "run" / "figures.json").read_text())
    grown = {name: len(rows) for name, rows in figures["grooms"].items()}
    assert grown["library, as trained"] == 2
    assert grown["own grooms, as trained"] == grown["other grooms, unseen"] == 1
    # It is no growing of the bundled style that it is called like.
    assert [row["groom"] for row in figures["grooms"]["own grooms, as trained"]] == ["own:bob"]
    assert grown["held-out styles"] == 2
    assert figures["codes"]["new seeds"]["grooms"] == 3
    assert groom_code(grooms["bob"], encoder=load_groom_encoder(tmp_path / "run" / "groom_code.safetensors")).shape == (
        16,
    )


def test_what_cannot_be_trained_on_is_refused_in_one_line(
    grooms: dict[str, Groom], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def too_late(*arguments: object) -> None:
        raise AssertionError("grew its grooms first")

    monkeypatch.setattr(train_code, "cached_samples", too_late)
    write_groom(tmp_path / "mine.npz", replace(grooms["afro"], name="Ratboy_mohawk"))
    (tmp_path / "file").touch()
    for options, complaint in (
        (["--out", str(tmp_path / "run"), "--groom", "mohawk/Ratboy_mohawk.tfx"], "held out"),
        (["--out", str(tmp_path / "run"), "--groom", str(tmp_path / "mine.npz")], "held out"),
        (["--out", str(tmp_path / "file" / "run")], "a folder for the run"),
    ):
        with pytest.raises(SystemExit) as stop:
            main(["train-code", *options])
        assert stop.value.code == 2
        told = capsys.readouterr().err
        assert complaint in told
        assert told.count("\n") == 1


@pytest.mark.slow
def test_scatter_is_what_seeds_differ_by(samples: list[GroomSample], anew: dict[str, Groom], body: BodyModel) -> None:
    straight, again = samples[0], sample_of(anew["long_straight"], body, "long_straight")
    assert 1 < style_scatter(straight, [again]) < 5
    longer = style_scatter(straight, [scaled(again, 1.5)])
    # Half a length too long: in the mean over the vertices a quarter of a length off.
    assert 18 < longer < 30
    assert list(scatter_of_styles([straight, again, samples[1]])) == ["long_straight"]


def test_a_folder_of_other_grooms_is_refused(samples: list[GroomSample], tmp_path: Path) -> None:
    Training(GroomCodeRecipe(TINY, samples[:2], []), tmp_path).save()
    with pytest.raises(InputError, match="2 grooms"):
        Training(GroomCodeRecipe(TINY, samples[:3], []), tmp_path).resume()
    (tmp_path / "checkpoint.pt").write_bytes(b"nothing")
    with pytest.raises(InputError, match="checkpoint"):
        Training(GroomCodeRecipe(TINY, samples[:2], []), tmp_path).resume()


def test_impossible_settings_are_refused() -> None:
    for wrong in (
        *({"steps": 0}, {"library_seeds": 0}, {"family": -1}, {"library_share": 1.5}),
        *({"learning_rate": 0.0}, {"seed": -1}, {"widths": (16, 16, 16, 0)}),
    ):
        with pytest.raises(InputError, match=next(iter(wrong)).replace("_", "-")):
            GroomCodeConfig(**wrong)


def test_broken_weights_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.safetensors"
    with pytest.raises(InputError, match="no such file"):
        load_groom_encoder(path)
    path.write_bytes(b"0123456789")
    with pytest.raises(InputError, match="groom encoder"):
        load_groom_encoder(path)
    save_encoder(path, GroomAutoencoder(NARROW), {})
    assert not any(parameter.requires_grad for parameter in load_groom_encoder(path).parameters())
    with pytest.raises(InputError, match="widths"):
        load_groom_autoencoder(path)
    network = GroomAutoencoder(NARROW)
    save_autoencoder(path, network, {})
    with pytest.raises(InputError, match="GroomEncoder"):
        load_groom_encoder(path)
    network.decoder.mean.data[0, 0] = torch.nan
    save_autoencoder(path, network, {})
    with pytest.raises(InputError, match="NaN"):
        load_groom_autoencoder(path)


def test_grooms_of_another_layout_are_refused(body: BodyModel, grooms: dict[str, Groom]) -> None:
    bob = grooms["bob"]
    with pytest.raises(InputError, match="24 vertices"):
        groom_code(replace(bob, rest_strands=bob.rest_strands[:, :20]), body)
    with pytest.raises(InputError, match="one strand a texel"):
        groom_code(bob.select(torch.tensor([0, 1, 1])), body)
    off = replace(bob, root_faces=torch.zeros_like(bob.root_faces))
    with pytest.raises(InputError, match="on the scalp"):
        groom_code(off, body)


@pytest.mark.slow
def test_half_way_between_codes_of_a_linear_decoder(samples: list[GroomSample]) -> None:
    """Where the decoded vertices are linear in the code, half-way is the middle and there is no detour."""
    network = GroomAutoencoder(NARROW)
    for module in network.decoder.texture.modules():
        for name, child in module.named_children():
            if isinstance(child, torch.nn.SiLU):
                setattr(module, name, torch.nn.Identity())
    to_texels = network.decoder.texture.to_texels[0]
    with torch.no_grad():
        to_texels.weight[:4] = 0  # the log lengths, before the pixel shuffle
    row = betweenness(network, samples[0], samples[2])
    assert row["share"] == pytest.approx(0.5, abs=1e-3)
    assert row["detour"] == pytest.approx(0, abs=1e-3)
    figures = interpolation_metrics(network, samples[:3])
    assert figures["share"]["pairs"] == 3


# ---- the shipped encoder ----


def test_the_shipped_weights_are_small() -> None:
    assert WEIGHTS.stat().st_size <= 2_000_000
    assert sum(parameter.numel() for parameter in load_groom_encoder().parameters()) <= 1_000_000


def test_the_code_does_not_depend_on_the_order_of_strands(body: BodyModel, grooms: dict[str, Groom]) -> None:
    groom = grooms["afro"]
    shuffled = groom.select(torch.randperm(len(groom), generator=torch.Generator().manual_seed(1)))
    code = groom_code(groom, body)
    assert code.shape == (16,)
    assert torch.equal(groom_code(shuffled, body), code)


@pytest.mark.slow
def test_codes_tell_styles_apart_grown_anew_and_thinned(
    body: BodyModel, samples: list[GroomSample], anew: dict[str, Groom]
) -> None:
    encoder = load_groom_encoder()
    figures = code_metrics(encoder, samples, [sample_of(groom, body, name) for name, groom in anew.items()])
    # One of the four is a style that no training has seen.
    for row in figures.values():
        assert row["style_accuracy_percent"] == 100
        assert row["shift_largest"] < 0.5
    assert not torch.equal(codes_of(encoder, samples[:1]), codes_of(encoder, [half_of(samples[0], 0)]))


@pytest.mark.slow
@pytest.mark.shared_data
def test_real_grooms_have_codes_of_ordinary_size(body: BodyModel, registered: Registered) -> None:
    groom, _ = registered("grooms/mohawk/Ratboy_mohawk.tfx")
    code = groom_code(select_guides(groom), body)
    assert code.isfinite().all()
    assert code.abs().max() < 8
