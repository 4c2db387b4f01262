"""`quaffure train-code`: the groom autoencoder, from growing its grooms to the figures of its codes."""

import json
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from statistics import mean
from typing import Any

import tyro
from rich.console import Console
from rich.progress import Progress, TaskID, TimeRemainingColumn

from quaffure.apps.cli.console import print_json, print_rows, progress_columns
from quaffure.benchmark.evaluation_set import refuse_evaluation_data
from quaffure.benchmark.groom_code_metrics import (
    code_metrics,
    interpolation_metrics,
    reconstruction,
    scatter_of_styles,
    summary,
)
from quaffure.body.body_model import BodyModel, load_body
from quaffure.geometry.surface import Surface
from quaffure.hair.clearance import rest_surface
from quaffure.hair.groom import Groom
from quaffure.io.atomic import made_folder, replacing
from quaffure.io.load_groom import load_groom
from quaffure.model.groom_autoencoder import GroomAutoencoder
from quaffure.model.groom_code import load_groom_autoencoder
from quaffure.model.groom_texture import GroomSample, sample_of
from quaffure.procedural.hair_style import HELD_OUT, STYLES
from quaffure.training.groom_samples import ProceduralGroom, cached_samples, family_grooms, library_grooms
from quaffure.training.loop import Training, train
from quaffure.training.run_folder import RUN
from quaffure.training.train_groom_code import GroomCodeConfig, GroomCodeRecipe, finish

TRAINED = [name for name in STYLES if name not in HELD_OUT]
# Seeds that no training uses.
ANEW = range(1000, 1003)
UNSEEN_DRAWS = range(1_000_000, 1_000_060)
# Draws of the training that are measured beside the unseen ones.
SEEN_DRAWS = 60


@dataclass(frozen=True)
class Garden:
    """Where grooms are grown: the body, its surface at rest, and the folder that keeps them."""

    body: BodyModel
    surface: Surface
    folder: Path

    def grow(self, growings: list[ProceduralGroom], what: str) -> list[GroomSample]:
        with _progress(what, len(growings), 0) as (progress, task):
            return cached_samples(
                growings, self.body, self.surface, self.folder, lambda done: progress.update(task, completed=done)
            )


@dataclass(frozen=True)
class TrainCodeCommand:
    """Train the groom autoencoder whose encoder gives every groom its code; carries on where an earlier run stopped.

    The folder then holds `groom_code.safetensors`, the encoder, `groom_autoencoder.safetensors`, encoder and decoder,
    and `figures.json`.
    """

    out: Path
    """Folder of the run; made where it does not exist. The grooms are kept in it: 370 kB each."""
    groom: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """A groom to train on besides the bundled styles and the continuous family; may be given several times. Grooms that
    are held out for evaluation are refused."""
    unseen: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """A groom to be measured on and not trained on, besides the held-out styles; may be given several times."""
    keep_encoder: Path | None = None
    """The `groom_autoencoder.safetensors` of an earlier run: its encoder stays as it is, and with it all codes; only
    its decoder is trained on."""
    json: bool = False
    """Print the figures as JSON instead of tables."""
    config: GroomCodeConfig = field(default_factory=GroomCodeConfig)

    def run(self) -> None:
        refuse_evaluation_data(self.groom)
        begun = load_groom_autoencoder(self.keep_encoder) if self.keep_encoder is not None else None
        body = load_body()
        garden = Garden(body, rest_surface(body), made_folder(self.out / "grooms", RUN))
        own, unseen = self._own(body), _samples([load_groom(name, body) for name in self.unseen], body)
        library = garden.grow(library_grooms(TRAINED, range(self.config.library_seeds)), "growing the library")
        family = garden.grow(family_grooms(range(self.config.family)), "growing the family")
        network = self._train(Training(GroomCodeRecipe(self.config, library + own, family, begun), self.out))
        first = [groom for index, groom in enumerate(library) if index % self.config.library_seeds == 0]
        figures = _figures(network, garden, {"library": first, "family": family[:SEEN_DRAWS], "own": own}, unseen)
        with replacing(self.out / "figures.json") as path:
            path.write_text(json.dumps(figures, indent=1))
        print_json(figures) if self.json else _print(figures)

    def _own(self, body: BodyModel) -> list[GroomSample]:
        grooms = [load_groom(name, body) for name in self.groom]
        # A groom file keeps the groom's name whatever the file is called.
        refuse_evaluation_data(groom.name for groom in grooms)
        # One that is called like a bundled style is no growing of it.
        return _samples([replace(groom, name=f"own:{groom.name}") for groom in grooms], body)

    def _train(self, training: Training[GroomCodeRecipe]) -> GroomAutoencoder:
        if training.resume():
            Console(stderr=True).print(f"carrying on from step {training.step}")
        smooth = 0.0
        with _progress("training", training.recipe.config.steps, training.step) as (progress, task):

            def report(step: int, metrics: dict[str, float]) -> None:
                nonlocal smooth
                loss = metrics["loss"]
                if math.isfinite(loss):
                    smooth = loss if smooth == 0.0 else 0.98 * smooth + 0.02 * loss
                progress.update(task, completed=step, description=f"loss {smooth:.4f} strand lengths")

            train(training, report)
        if training.optimizer.skipped:
            Console(stderr=True).print(f"{training.optimizer.skipped} updates skipped: gradients that were not finite")
        return finish(training)


def _samples(grooms: list[Groom], body: BodyModel) -> list[GroomSample]:
    return [sample_of(groom, body, groom.name) for groom in grooms]


def _figures(
    network: GroomAutoencoder, garden: Garden, seen: dict[str, list[GroomSample]], unseen: list[GroomSample]
) -> dict[str, Any]:
    # Each style once, and again by seeds that no training uses.
    known = garden.grow(library_grooms(STYLES, [0]), "growing every style")
    anew = garden.grow(library_grooms(STYLES, ANEW), "growing every style anew")
    groups = {
        "library, as trained": seen["library"],
        "library, grown anew": [groom for groom in anew if groom.style in TRAINED],
        "own grooms, as trained": seen["own"],
        "family, as trained": seen["family"],
        "family, unseen": garden.grow(family_grooms(UNSEEN_DRAWS), "growing unseen draws"),
        "held-out styles": [groom for groom in known + anew if groom.style in HELD_OUT],
        "other grooms, unseen": unseen,
    }
    rows = {name: [reconstruction(network, groom) for groom in grooms] for name, grooms in groups.items() if grooms}
    return {
        "reconstruction": {name: summary(of_group) for name, of_group in rows.items()},
        "grooms": {name: [asdict(row) for row in of_group] for name, of_group in rows.items()},
        "codes": code_metrics(network.encoder, known, anew),
        "scatter": scatter_of_styles(known + anew),
        "half_way": interpolation_metrics(network, seen["library"]),
    }


def _print(figures: dict[str, Any]) -> None:
    rows = [{"set": name} | row for name, row in figures["reconstruction"].items()]
    print_rows(rows, "encoded and decoded, means over grooms")
    groups = {"trained": TRAINED, "held out": HELD_OUT}
    of_group = {
        name: [figures["scatter"][style] for style in STYLES if style in group] for name, group in groups.items()
    }
    rows = [{"styles": name, "length_percent": mean(values)} for name, values in of_group.items()]
    print_rows(rows, "what chance makes of a style: its growings from each other")
    print_rows([{"styles": name} | row for name, row in figures["codes"].items()], "codes of styles")
    print_rows([{"half-way": name} | row for name, row in figures["half_way"].items()], "between two codes")


@contextmanager
def _progress(what: str, total: int, done: int) -> Iterator[tuple[Progress, TaskID]]:
    # The standard output is for the figures, which other programs may read.
    with Progress(*progress_columns(TimeRemainingColumn()), console=Console(stderr=True)) as progress:
        yield progress, progress.add_task(what, total=total, completed=done)
