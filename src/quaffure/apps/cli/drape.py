"""`quaffure drape`: drape a groom on a moving body, and write draped hair, pictures, video or USD."""

from collections.abc import Sized
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from quaffure.apps.cli.console import console, print_json, print_rows, progress_bar
from quaffure.apps.cli.inputs import body_shape_of, motion_of
from quaffure.apps.cli.outputs import check_outputs, write_output
from quaffure.baselines.groomgen import GroomGenDraper, load_groomgen
from quaffure.benchmark.metrics import DrapeMetrics, PerFrame
from quaffure.body.body_model import load_body
from quaffure.drape_motion import FRAMES_AT_ONCE, drape_motion
from quaffure.draper import Draper
from quaffure.energies.hair_terms import ELASTIC_MODELS, MODIFIED_COSSERAT, ROD
from quaffure.energies.sag_free import sag_free_rest
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
from quaffure.types import Float, Positions, Tensor

NEURAL, GROOMGEN = "neural", GroomGenDraper.name


@dataclass(frozen=True)
class DrapeCommand:
    """Drape a groom on a moving body, write it, and print metrics."""

    groom: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="GROOM")]
    """A bundled groom (see `quaffure grooms`) or a file: .hair, .data, .bin, .tfx, .usd, .npz."""
    out: tyro.conf.UseAppendAction[tuple[Path, ...]]
    """Where to write; may be given several times. The suffix picks the format: .npz, .usd, .usda, .usdc, .png, .mp4."""
    motion: str = "neck_turn"
    """A bundled clip, or a .bvh or .npz file."""
    frames: str = ":"
    """Frames A:B:STEP of the motion at 30 frames per second."""
    in_place: bool = False
    """Leave out the path of the body through the world; it turns, but does not travel."""
    shape: str = ""
    """Ten body shape coefficients separated by commas, or a file that holds them; without it, the mean body."""
    head: Path | None = None
    """The head mesh (.obj) that a groom file was made on; helps to register it."""
    draper: Annotated[str, tyro.conf.arg(metavar=f"{{{NEURAL},{GROOMGEN},{','.join(SOLVERS)}}}")] = NEURAL
    """The method: the network, the supervised baseline (docs/groomgen.md), or one of the solvers (docs/solvers.md)."""
    refine: int = 0
    """Steps of Adam from the output of the network; 0 is the network alone."""
    elastic: Annotated[str, tyro.conf.arg(metavar=f"{{{','.join(ELASTIC_MODELS)}}}")] = MODIFIED_COSSERAT
    """The elastic model, for adam and lbfgs in all their forms. Metrics are those of the default one."""
    rest: Literal["design", "stress-free"] | None = None
    """With --elastic rod: the rest shape that keeps hair as designed on the mean body (design, the default), or the
    groom itself, from which gravity bends it."""
    weights: Path | None = None
    """Weights of a training run instead of the shipped ones; those of `quaffure train-groomgen` for groomgen."""
    reference: Path | None = None
    """An .npz drape of the same groom and frames by a solver, to measure against."""
    strands: int | None = None
    """Strands to interpolate between the draped ones for .png, .mp4 and .usd*: 10,000 to 100,000 make a full head
    of hair. Without it, the draped strands are shown. An .npz always holds the draped strands."""
    json: bool = False
    """Print the metrics as JSON."""

    def run(self) -> None:
        console.quiet = self.json
        check_outputs(self.out)
        body = load_body()
        motion = motion_of(self.motion, body, self.in_place).frames(self.frames)
        body_shape = body_shape_of(self.shape)
        if float(body_shape.abs().max()) > LARGEST_COEFFICIENT:
            console.print(f"shape: beyond the trained and measured +-{LARGEST_COEFFICIENT:g} standard deviations")
        reference = None if self.reference is None else read_drape(self.reference)
        draper = self._draper()
        console.print(f"reading the groom {self.groom}")
        groom = load_groom(self.groom, body, self.head)
        if self.elastic == ROD and self.rest != "stress-free":
            design = sag_free_rest(groom, body, draper.material)
            if bool(design.unstable.any()):
                console.print(f"{int(design.unstable.sum())} strands will not keep the design")
            draper = solver(self.draper, draper.material, self.elastic, design)
        interpolation = None if self.strands is None else interpolation_of(groom, body, self.strands)
        shape = (len(motion), *groom.rest_strands.shape)
        if reference is not None and reference.strands.shape != shape:
            raise InputError(f"{self.reference}", f"strands {shape}", f"{reference.strands.shape}")
        console.print(f"draping {len(groom)} strands in {_frames(len(motion))} with {self._row}")
        if self.refine and len(motion) > 1:
            console.print("refined frame by frame: hair that moves will jitter")
        measured = DrapeMetrics(groom, draper.material, reference)
        with progress_bar("draping", len(motion), transient=True) as update:

            def on_frames(draped: Positions, scene: Scene) -> None:
                measured.add(draped, scene)
                update(advance=len(draped))

            sequence = drape_motion(draper, groom, body, motion, body_shape, on_frames)
        if self.draper in SOLVERS:  # `--elastic` does not choose the model that a network was trained with
            sequence.meta["elastic"] = self.elastic
        if self.elastic == ROD:
            sequence.meta["rest"] = self.rest or "design"
        for path in self.out:
            console.print(f"writing {path}")
            write_output(path, sequence, interpolation)
        self._report(sequence, *measured.of_all_frames())

    @property
    def _row(self) -> str:
        """The name of the draper in `quaffure evaluate`."""
        return RefinedDraper.name if self.refine else self.draper

    def _draper(self) -> Draper:
        """The draper by name; solvers get the material that the weights were trained for, to be comparable."""
        if self.draper not in (NEURAL, GROOMGEN, *SOLVERS):
            raise InputError("--draper", f"one of {', '.join((NEURAL, GROOMGEN, *SOLVERS))}", f"'{self.draper}'")
        if self.refine and self.draper != NEURAL:
            raise InputError("--refine", f"the draper {NEURAL}", f"'{self.draper}'")
        if self.refine < 0:
            raise InputError("--refine", "0 or more", f"{self.refine}")
        if self.rest is not None and self.elastic != ROD:
            raise InputError("--rest", f"--elastic {ROD}", f"'{self.elastic}'")
        if self.draper in SOLVERS:
            return solver(self.draper, load_model(self.weights).draper.material, self.elastic)
        if self.elastic != MODIFIED_COSSERAT:
            raise InputError("--elastic", f"{MODIFIED_COSSERAT} with a network", f"'{self.elastic}'")
        if self.draper == NEURAL:
            neural = load_model(self.weights).draper
            return RefinedDraper(neural, self.refine) if self.refine else neural
        if self.weights is None:
            raise InputError("--weights", f"weights of quaffure train-groomgen with the draper {GROOMGEN}", "none")
        return load_groomgen(self.weights)[0]

    def _report(self, sequence: DrapeSequence, draped: PerFrame, posed: PerFrame) -> None:
        named = {"posed": posed, self._row: draped}
        if self.json:
            rows = {name: {key: values.tolist() for key, values in row.items()} for name, row in named.items()}
            times = {"milliseconds": sequence.meta["milliseconds"], "with_preparation": with_preparation(sequence)}
            print_json({"per_frame": rows, **times, "meta": sequence.meta})
            return
        title = f"{sequence.meta['groom']} on {sequence.meta['motion']}, {_frames(len(sequence))}"
        print_rows([_table_row(key, named, draped[key]) for key in draped], title)
        first = ", with the preparation of kernels and groom" if with_preparation(sequence) else ""
        taken = duration(float(sequence.meta["milliseconds"]))
        console.print(f"{taken} a drape{first}; written: {', '.join(map(str, self.out))}")


def _table_row(key: str, named: dict[str, PerFrame], draped: Float[Tensor, " frames"]) -> dict[str, object]:
    """Mean and worst frame of a metric for each row, and how often the drape is better than the posed groom."""
    row: dict[str, object] = {"metric": key}
    for name, values in named.items():
        known = values.get(key)
        row[name] = "" if known is None else float(known.mean())
        row[f"{name}, worst frame"] = "" if known is None else float(known.max())
    # Posed hair has no orientation error by definition: no drape has less.
    compared = key in named["posed"] and key != "orientation_error_deg"
    row["frames better"] = f"{int((draped < named['posed'][key]).sum())} of {len(draped)}" if compared else ""
    return row


def with_preparation(sequence: Sized) -> bool:
    """Whether its time includes the preparation of kernels and groom; in long clips only later frames count."""
    return len(sequence) <= FRAMES_AT_ONCE


def duration(milliseconds: float) -> str:
    return f"{milliseconds:.3g} ms" if milliseconds < 1000 else f"{milliseconds / 1000:.3g} s"


def _frames(count: int) -> str:
    return "1 frame" if count == 1 else f"{count} frames"
