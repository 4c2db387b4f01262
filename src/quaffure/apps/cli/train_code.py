"""`quaffure train-code`: make grooms, train the groom autoencoder on them, and measure its codes."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from statistics import mean
from typing import Any

import tyro

from quaffure.apps.cli.console import PlainConsole, Text, print_json, print_rows, progress_bar, run_training
from quaffure.benchmark.evaluation_set import refuse_evaluation_data
from quaffure.benchmark.groom_code_metrics import (
    code_metrics,
    interpolation_metrics,
    reconstruction,
    scatter_of_styles,
    summary,
)
from quaffure.body.body_model import BodyModel, load_body
from quaffure.hair.groom import Groom
from quaffure.io.atomic import write_json
from quaffure.io.load_groom import load_groom
from quaffure.io.output_path import check_output_folder, made_folder
from quaffure.model.groom_autoencoder import GroomAutoencoder
from quaffure.model.groom_code import load_groom_autoencoder
from quaffure.model.groom_texture import GroomSample, sample_of
from quaffure.procedural.hair_style import HELD_OUT, STYLES
from quaffure.training.groom_samples import ProceduralGroom, cached_samples, family_grooms, library_grooms
from quaffure.training.loop import Training
from quaffure.training.run_folder import RUN
from quaffure.training.train_groom_code import AUTOENCODER, ENCODER, GroomCodeConfig, GroomCodeRecipe, finish

# The standard output is for the results, which other programs may read.
messages = PlainConsole(stderr=True)
TRAINED = [name for name in STYLES if name not in HELD_OUT]
# Seeds that no training uses.
NEW_SEEDS = range(1000, 1003)
UNSEEN_SAMPLES = range(1_000_000, 1_000_060)
# Samples of the training to measure, for comparison with the unseen ones.
SEEN_SAMPLES = 60


Samples = Callable[[list[ProceduralGroom], str], list[GroomSample]]
"""Makes grooms, with a description for the bar, or reads those that the folder has."""


@dataclass(frozen=True)
class TrainCodeCommand:
    """Train the groom autoencoder whose encoder computes the codes of grooms; continues where an earlier run stopped.

    The folder then holds `groom_code.safetensors`, the encoder, `groom_autoencoder.safetensors`, encoder and decoder,
    and `figures.json`.
    """

    out: Path
    """Folder of the run; made if it does not exist. It keeps the grooms: 370 kB each."""
    groom: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """A groom to train on in addition to the bundled styles and the continuous family; may be given several times.
    Grooms that are held out for evaluation are refused."""
    unseen: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """A groom to measure and not to train on, in addition to the held-out styles; may be given several times."""
    keep_encoder: Path | None = None
    """The `groom_autoencoder.safetensors` of an earlier run: its encoder, and so all codes, stay as they are; only
    its decoder is trained further."""
    json: bool = False
    """Print the metrics as JSON instead of tables."""
    config: GroomCodeConfig = field(default_factory=GroomCodeConfig)

    def run(self) -> None:
        check_output_folder(self.out, RUN, (ENCODER, AUTOENCODER), (self.keep_encoder,))
        refuse_evaluation_data(self.groom)
        started = load_groom_autoencoder(self.keep_encoder) if self.keep_encoder is not None else None
        body, folder = load_body(), made_folder(self.out / "grooms", RUN)

        def samples(grooms: list[ProceduralGroom], description: str) -> list[GroomSample]:
            with progress_bar(description, len(grooms), to=messages) as update:
                return cached_samples(grooms, body, folder, lambda done: update(completed=done))

        own, unseen = self._own(body), _samples([load_groom(name, body) for name in self.unseen], body)
        library = samples(library_grooms(TRAINED, range(self.config.library_seeds)), "making the library")
        family = samples(family_grooms(range(self.config.family)), "making the family")
        training = Training(GroomCodeRecipe(self.config, library + own, family, started), self.out)
        run_training(training, smoothed_loss(), to=messages)
        network = finish(training)
        first = [groom for index, groom in enumerate(library) if index % self.config.library_seeds == 0]
        metrics = _metrics(network, samples, {"library": first, "family": family[:SEEN_SAMPLES], "own": own}, unseen)
        write_json(self.out / "figures.json", metrics)
        print_json(metrics) if self.json else _print(metrics)

    def _own(self, body: BodyModel) -> list[GroomSample]:
        grooms = [load_groom(name, body) for name in self.groom]
        # The name of a groom is in its file, whatever the name of the file.
        refuse_evaluation_data(groom.name for groom in grooms)
        # A groom with the name of a bundled style is not a sample of that style.
        return _samples([replace(groom, name=f"own:{groom.name}") for groom in grooms], body)


def smoothed_loss() -> Text:
    """The text of the bar: the moving average of the loss."""
    smooth = 0.0

    def bar_text(values: dict[str, float]) -> str:
        nonlocal smooth
        if math.isfinite(loss := values["loss"]):
            smooth = loss if smooth == 0.0 else 0.98 * smooth + 0.02 * loss
        return f"loss {smooth:.4f} strand lengths"

    return bar_text


def _samples(grooms: list[Groom], body: BodyModel) -> list[GroomSample]:
    return [sample_of(groom, body, groom.name) for groom in grooms]


def _metrics(
    network: GroomAutoencoder, samples: Samples, seen: dict[str, list[GroomSample]], unseen: list[GroomSample]
) -> dict[str, Any]:
    # Each style once, and again with seeds that no training uses.
    known = samples(library_grooms(STYLES, [0]), "making every style")
    new = samples(library_grooms(STYLES, NEW_SEEDS), "making every style with new seeds")
    groups = {
        "library, as trained": seen["library"],
        "library, new seeds": [groom for groom in new if groom.style in TRAINED],
        "own grooms, as trained": seen["own"],
        "family, as trained": seen["family"],
        "family, unseen": samples(family_grooms(UNSEEN_SAMPLES), "making unseen samples"),
        "held-out styles": [groom for groom in known + new if groom.style in HELD_OUT],
        "other grooms, unseen": unseen,
    }
    rows = {name: [reconstruction(network, groom) for groom in grooms] for name, grooms in groups.items() if grooms}
    return {
        "reconstruction": {name: summary(of_group) for name, of_group in rows.items()},
        "grooms": rows,
        "codes": code_metrics(network.encoder, known, new),
        "scatter": scatter_of_styles(known + new),
        "half_way": interpolation_metrics(network, seen["library"]),
    }


def _print(metrics: dict[str, Any]) -> None:
    rows = [{"set": name} | row for name, row in metrics["reconstruction"].items()]
    print_rows(rows, "encoded and decoded, means over grooms")
    rows = [
        {"styles": name, "length_percent": mean(metrics["scatter"][style] for style in STYLES if style in group)}
        for name, group in (("trained", TRAINED), ("held out", HELD_OUT))
    ]
    print_rows(rows, "distance between samples of one style")
    print_rows([{"styles": name} | row for name, row in metrics["codes"].items()], "codes of styles")
    print_rows([{"half-way": name} | row for name, row in metrics["half_way"].items()], "between two codes")
