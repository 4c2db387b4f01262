"""`quaffure drape`: a groom, a body and a motion in; draped hair out."""

from collections.abc import Sized
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.progress import Progress

from quaffure.apps.cli.console import console, print_json, print_rows
from quaffure.apps.cli.inputs import body_shape_of, motion_of
from quaffure.apps.cli.outputs import writer_for
from quaffure.baselines.groomgen import GroomGenDraper, load_groomgen
from quaffure.benchmark.metrics import DrapeMetrics, PerFrame
from quaffure.body.body_model import load_body
from quaffure.drape_motion import FRAMES_AT_ONCE, drape_motion
from quaffure.draper import Draper
from quaffure.energies.hair_terms import ELASTIC_MODELS, MODIFIED_COSSERAT
from quaffure.errors import InputError
from quaffure.hair.drape_sequence import DrapeSequence
from quaffure.hair.guide_interpolation import interpolation_of
from quaffure.io.drape_file import read_drape
from quaffure.io.load_groom import load_groom
from quaffure.model.quaffure_model import load_model
from quaffure.scene import Scene
from quaffure.solvers.by_name import SOLVERS, solver
from quaffure.solvers.refined import RefinedDraper
from quaffure.training.pose_sampler import LARGEST_COEFFICIENT
from quaffure.types import Positions

NEURAL, GROOMGEN = "neural", GroomGenDraper.name


@dataclass(frozen=True)
class DrapeCommand:
    """Drape a groom on a moving body, write it, and print figures of merit."""

    groom: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="GROOM")]
    """A bundled groom (see `quaffure grooms`) or a file: .hair, .data, .bin, .tfx, .usd, .npz."""
    out: tyro.conf.UseAppendAction[tuple[Path, ...]]
    """Where to write; may be given several times. The suffix picks the format: .npz, .usd, .usda, .usdc, .png, .mp4."""
    motion: str = "neck_turn"
    """A bundled clip, or a .bvh or .npz file."""
    frames: str = ":"
    """Frames A:B:STEP of the motion at 30 frames per second."""
    shape: str = ""
    """Ten body shape coefficients separated by commas, or a file that holds them; without it, the mean body."""
    head: Path | None = None
    """The head mesh (.obj) that a groom file was made on; helps to register it."""
    draper: Annotated[str, tyro.conf.arg(metavar=f"{{{NEURAL},{GROOMGEN},{','.join(SOLVERS)}}}")] = NEURAL
    """How to settle the hair: the network, the supervised baseline (docs/groomgen.md), or one of the solvers
    (docs/solvers.md)."""
    refine: int = 0
    """Steps of Adam from the network's answer; 0 is the network alone."""
    elastic: Annotated[str, tyro.conf.arg(metavar=f"{{{','.join(ELASTIC_MODELS)}}}")] = MODIFIED_COSSERAT
    """The elastic model, for adam and lbfgs in all their forms. Figures of merit are those of the default one."""
    weights: Path | None = None
    """Weights of a training run instead of the shipped ones; those of `quaffure train-groomgen` for groomgen."""
    reference: Path | None = None
    """An .npz drape of the same groom and frames by a solver, to measure against."""
    strands: int | None = None
    """Strands to interpolate between the draped ones for .png, .mp4 and .usd*: 10,000 to 100,000 are a full head of
    hair. Without it, the draped strands are shown. An .npz always holds the draped strands."""
    json: bool = False
    """Print the figures of merit as JSON."""

    def run(self) -> None:
        if not self.out:
            raise InputError("--out", "at least one file to write", "none")
        writers = [writer_for(path) for path in self.out]
        body = load_body()
        motion = motion_of(self.motion, body).frames(self.frames)
        body_shape = body_shape_of(self.shape)
        if float(body_shape.abs().max()) > LARGEST_COEFFICIENT:
            self._say(f"shape: nothing was trained or measured beyond +-{LARGEST_COEFFICIENT:g} standard deviations")
        reference = None if self.reference is None else read_drape(self.reference)
        draper = self._draper()
        self._say(f"reading the groom {self.groom}")
        groom = load_groom(self.groom, body, self.head)
        interpolation = None if self.strands is None else interpolation_of(groom, body, self.strands)
        if reference is not None:
            self._check_reference(reference, (len(motion), *groom.rest_strands.shape))
        self._say(f"draping {len(groom)} strands in {_frames(len(motion))} with {self._row}")
        if self.refine and len(motion) > 1:
            self._say("refined frame by frame: hair that moves will tremble")
        measured = DrapeMetrics(groom, draper.material, reference)
        with Progress(console=console, transient=True) as progress:
            task = progress.add_task(f"draping {len(groom)} strands", total=len(motion))

            def on_frames(draped: Positions, scene: Scene) -> None:
                measured.add(draped, scene)
                progress.advance(task, len(draped))

            sequence = drape_motion(draper, groom, body, motion, body_shape, on_frames)
        if self.draper in SOLVERS:  # a network was trained with one, which `--elastic` does not choose
            sequence.meta["elastic"] = self.elastic
        for path, write in zip(self.out, writers):
            self._say(f"writing {path}")
            write(path, sequence, interpolation)
        self._report(sequence, *measured.of_all_frames())

    @property
    def _row(self) -> str:
        """What `quaffure evaluate` calls the draper."""
        return RefinedDraper.name if self.refine else self.draper

    def _say(self, step: str) -> None:
        """What is going on; not where the output is JSON for another program."""
        if not self.json:
            console.print(step)

    def _check_reference(self, reference: DrapeSequence, shape: tuple[int, ...]) -> None:
        """Before the work and not after it."""
        if reference.strands.shape != shape:
            raise InputError(f"{self.reference}", f"strands {shape}", f"{reference.strands.shape}")

    def _draper(self) -> Draper:
        """The draper asked for; solvers take the material that the weights were trained for, to be comparable."""
        if self.draper not in (NEURAL, GROOMGEN, *SOLVERS):
            raise InputError("--draper", f"one of {', '.join((NEURAL, GROOMGEN, *SOLVERS))}", f"'{self.draper}'")
        if self.refine and self.draper != NEURAL:
            raise InputError("--refine", f"the draper {NEURAL}", f"'{self.draper}'")
        if self.draper == GROOMGEN:
            return self._groomgen()
        model = load_model(self.weights)
        if self.draper != NEURAL:
            return solver(self.draper, model.draper.material, self.elastic)
        if self.refine < 0:
            raise InputError("--refine", "0 or more", f"{self.refine}")
        self._check_elastic()
        return RefinedDraper(model.draper, self.refine) if self.refine else model.draper

    def _groomgen(self) -> Draper:
        if self.weights is None:
            raise InputError("--weights", f"weights of quaffure train-groomgen with the draper {GROOMGEN}", "none")
        self._check_elastic()
        return load_groomgen(self.weights)[0]

    def _check_elastic(self) -> None:
        if self.elastic != MODIFIED_COSSERAT:
            raise InputError("--elastic", f"{MODIFIED_COSSERAT} with a network", f"'{self.elastic}'")

    def _report(self, sequence: DrapeSequence, draped: PerFrame, posed: PerFrame) -> None:
        named = {"posed": posed, self._row: draped}
        if self.json:
            rows = {name: {key: figure.tolist() for key, figure in row.items()} for name, row in named.items()}
            times = {"milliseconds": sequence.meta["milliseconds"], "with_preparation": with_preparation(sequence)}
            print_json({"per_frame": rows, **times, "meta": sequence.meta})
            return
        rows_printed: list[dict[str, object]] = []
        for key, figure in draped.items():
            row: dict[str, object] = {"figure of merit": key}
            for name, figures in named.items():
                known = figures.get(key)
                row[name] = "" if known is None else float(known.mean())
                row[f"{name}, worst frame"] = "" if known is None else float(known.max())
            # Posed hair has no orientation error by definition: nothing is better at it.
            judged = key in posed and key != "orientation_error_deg"
            row["frames better"] = f"{int((figure < posed[key]).sum())} of {len(figure)}" if judged else ""
            rows_printed.append(row)
        print_rows(rows_printed, f"{sequence.meta['groom']} on {sequence.meta['motion']}, {_frames(len(sequence))}")
        first = ", with what is prepared once (kernels, the groom)" if with_preparation(sequence) else ""
        taken = duration(float(sequence.meta["milliseconds"]))
        console.print(f"{taken} a drape{first}; written: {', '.join(map(str, self.out))}")


def with_preparation(sequence: Sized) -> bool:
    """Whether its time holds what is prepared once, kernels and groom; of long clips only later frames count."""
    return len(sequence) <= FRAMES_AT_ONCE


def duration(milliseconds: float) -> str:
    return f"{milliseconds:.3g} ms" if milliseconds < 1000 else f"{milliseconds / 1000:.3g} s"


def _frames(count: int) -> str:
    return "1 frame" if count == 1 else f"{count} frames"
