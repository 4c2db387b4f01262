"""`quaffure drape`: drape a groom on a moving body, and write draped hair, pictures, video or USD."""

import hashlib
import sys
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro

from quaffure.apps.cli.console import console, progress_bar
from quaffure.apps.cli.drape_report import (
    DRAPING,
    PREPARATION,
    Stopwatch,
    frames_text,
    print_drape_json,
    report_drape,
)
from quaffure.apps.cli.groom_report import loaded_groom
from quaffure.apps.cli.inputs import acceleration_of, body_shape_of, character_space_of, clip_of
from quaffure.apps.cli.kept_frames import kept_frames
from quaffure.apps.cli.outputs import (
    PICTURES,
    check_frames,
    check_outputs,
    is_export,
    write_output,
    writing_text,
    written_text,
)
from quaffure.apps.cli.shown_strands import clip_of_pictures, shown_in, strands_between
from quaffure.benchmark.drape_checks import DrapeChecks
from quaffure.benchmark.metrics import DrapeMetrics
from quaffure.body.body_model import BodyModel, load_body
from quaffure.body.motion import Motion
from quaffure.config import HairMaterial
from quaffure.digest import array_digest, file_digest
from quaffure.drape_motion import drape_motion
from quaffure.draper import Draper
from quaffure.drapers import DRAPERS, GROOMGEN, NEURAL, elastic_model_of, load_trained, with_coherence
from quaffure.energies.by_name import ELASTIC_MODELS, MODIFIED_COSSERAT, ROD, hair_terms
from quaffure.energies.energy_term import Terms
from quaffure.energies.gravity import GRAVITY, Acceleration
from quaffure.energies.loading import Loading
from quaffure.energies.sag_free import design_of
from quaffure.errors import InputError
from quaffure.hair.export_clip import ExportClip, ExportSettings
from quaffure.hair.groom import Groom
from quaffure.hair.groom_binding import groom_binding
from quaffure.hair.placed_clip import placed_clip
from quaffure.io.drape_file import read_drape
from quaffure.model.neural import NeuralDraper
from quaffure.model.quaffure_model import MODELS
from quaffure.scene import Scene
from quaffure.solvers.by_name import SOLVERS, solver
from quaffure.solvers.strand_newton import StrandNewtonDraper, with_settling
from quaffure.training.pose_sampler import LARGEST_COEFFICIENT
from quaffure.types import Float, Positions, Tensor

FAULTS_FOUND = 3
"""Exit code with --strict."""
MOST_SCALE = 100.0
"""Largest factor of stiffness and weight."""


@dataclass(frozen=True)
class DrapeCommand:
    """Drape a groom on a moving body and write it; print frames with hair inside the body or tips that jump."""

    groom: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="GROOM")]
    """A bundled groom (see `quaffure grooms`) or a file: .abc, .bin, .data, .hair, .npy, .npz, .ply, .tfx, .usd."""
    out: tyro.conf.UseAppendAction[tuple[Path, ...]]
    """Where to write; may be given several times. The suffix picks the format: .npz, .usd, .usda, .usdc, .abc, .glb; of
    one frame .hair, .ply, .data, .bin; .png (up to four frames, evenly spaced from the first to the last, each from
    four sides), .mp4 (every frame). An .abc, for Unreal a groom cache, comes with its groom asset: walk_groom.abc
    beside walk.abc."""
    motion: str = "neck_turn"
    """A bundled clip: neck_turn, bow, idle (4 s each), nod (3 s), shrug (2.4 s) or walk (2 s); or a file: .bvh of any
    skeleton, a character (.glb, .gltf, .fbx; FILE#NAME is one of several animations), .npz of AMASS, SMPL-X or poses of
    this body."""
    joints: Path | None = None
    """A joint map (.toml) for a motion whose joint names are not known; `quaffure inspect` writes one to edit."""
    frames: str = ":"
    """Frames A:B:STEP of the motion at 30 frames per second, from A up to B, which is not included; `30` alone is one
    frame. A clip starts at A: what moves before is not draped."""
    in_place: bool = False
    """Leave out the path of the body through the world; it turns, but does not travel."""
    body: Path | None = None
    """A body of your own (.npz, from `quaffure body import`) instead of the shipped one."""
    shape: str = ""
    """Ten body shape coefficients separated by commas, or a file that holds them; without it, the mean body."""
    head: Path | None = None
    """The head mesh (.obj, .ply) that a groom file was made on; helps to register it."""
    draper: Annotated[str | None, tyro.conf.arg(metavar=f"{{{','.join(DRAPERS)}}}")] = None
    """The method: one of the solvers (docs/solvers.md), the network, or the supervised baseline (docs/groomgen.md).
    Without it strand_newton, or with --weights the network."""
    coherent: Annotated[bool, tyro.conf.arg(help_behavior_hint="")] = True
    """With strand_newton: drape each frame by itself. Without this option, or with --coherent, the first frame is
    settled and every next one starts from the last, so that clips do not jump."""
    settle: Annotated[int, tyro.conf.arg(metavar="[INT]")] = 0
    """Passes of strand_newton from the output of another draper, 3 where no number follows; without the option that
    draper alone."""
    elastic: Annotated[str | None, tyro.conf.arg(metavar=f"{{{','.join(ELASTIC_MODELS)}}}")] = None
    """The elastic model: rod, but modified_cosserat, the paper's, with xpbd_paper, groomgen and --model paper; xpbd
    accepts both, adam and lbfgs in all their forms any. Metrics are those of the same model."""
    rest: Literal["design", "stress-free"] | None = None
    """With --elastic rod: the rest shape that keeps hair as designed on the mean body (design, the default), or the
    groom itself, from which gravity bends it."""
    stiffness: float = 1.0
    """Multiple of the hair's bending and twisting stiffness: 0.3 is fine, 3 is coarse hair."""
    weight: float = 1.0
    """Multiple of the hair's weight."""
    gravity: str = "0,0,-9.81"
    """Acceleration X,Y,Z of gravity along the world's axes: z is up, the body at rest faces -y [m/s^2]."""
    wind: str = "0,0,0"
    """Acceleration X,Y,Z by a wind that pulls all hair alike, along the same axes: 0,-3,0 blows from behind [m/s^2]."""
    weights: Path | None = None
    """Weights of a training run instead of the shipped ones; those of `quaffure train-groomgen` for groomgen."""
    model: Annotated[str | None, tyro.conf.arg(metavar=f"{{{','.join(MODELS)}}}")] = None
    """Shipped weights by name: quaffure, or paper, the paper's configuration (docs/paper_network.md)."""
    reference: Path | None = None
    """An .npz drape of the same groom and frames by a solver, to measure against; with it, all metrics are printed."""
    metrics: bool = False
    """Measure and print all metrics (docs/metrics.md), which takes longer than most drapes."""
    strict: bool = False
    """Exit with 3 where a tip jumps or, in a frame, more than 0.1 % of the vertices are inside the body; the files are
    written all the same."""
    strands: str | None = None
    """Strands for all files but .npz: a number of them to interpolate between the draped ones, 10,000 to 100,000 make
    a full head of hair; `original`, every strand of a groom file as it was made, driven by the draped ones (see
    docs/guides.md); or `guides`, the draped ones. Without it, files have the draped strands; pictures show 12,000
    and videos 6,000 between them, unless as many are draped. An .npz always holds the draped strands."""
    export: ExportSettings = field(default_factory=ExportSettings)
    resume: bool = False
    """Continue an interrupted run of the same command after its last frames, which are kept beside the first output."""
    json: bool = False
    """Print as JSON, frame by frame."""

    def run(self) -> None:
        console.quiet = self.json
        options = self.shape, self.body, self.head, self.joints, self.weights, self.reference
        inputs = self.groom, self.motion, *options
        check_outputs(self.out, inputs)
        times = Stopwatch()
        body = load_body(self.body)
        motion = clip_of(self.motion, body, self.in_place, self.joints, self.frames)
        check_frames(self.out, range(0, len(motion), self.export.every), self.export, inputs)
        space = character_space_of(self.motion, body, motion.times, self.export, self.joints)
        body_shape = body_shape_of(self.shape)
        if float(body_shape.abs().max()) > LARGEST_COEFFICIENT:
            console.print(f"shape: beyond the trained and measured +-{LARGEST_COEFFICIENT:g} standard deviations")
        reference = None if self.reference is None else read_drape(self.reference)
        self._check_options()
        groom = loaded_groom(self.groom, body, self.head)
        draper, terms = self._draper(groom, body)
        interpolation = strands_between(self.strands, self.groom, groom, body, self.head)
        shape = (len(motion), *groom.rest_strands.shape)
        if reference is not None and reference.strands.shape != shape:
            raise InputError(f"{self.reference}", f"strands {shape}", f"{reference.strands.shape}")
        console.print(f"draping {len(groom)} strands in {frames_text(len(motion))} with {draper.name}")
        checks, measured = DrapeChecks(motion.fps), None
        if self._measures:
            measured = DrapeMetrics(groom, draper.material, reference, terms, motion.fps)
        times.lap(PREPARATION)

        def on_frames(draped: Positions, scene: Scene) -> None:
            times.lap(DRAPING)
            checks.add(draped, scene)
            times.lap("checks")
            if measured is not None:
                measured.add(draped, scene)
                times.lap("metrics")

        with kept_frames(self.out[0], self._settings(groom, motion, body_shape), self.resume) as frames:
            with progress_bar("draping", len(motion), transient=True) as update:

                def on_batch(draped: Positions, scene: Scene) -> None:
                    on_frames(draped, scene)
                    update(advance=len(draped))

                sequence = drape_motion(draper, groom, body, motion, body_shape, on_batch, store=frames)
            self._describe(sequence.meta)
            times.lap(DRAPING)
            is_bound = is_export(self.out) or space is not None
            binding = groom_binding(groom, body, body_shape) if is_bound else None
            clip = ExportClip(sequence, interpolation, binding, self.export)
            self._write(clip if space is None else placed_clip(clip, space), groom, body, times)
        (print_drape_json if self.json else report_drape)(sequence, checks, measured, times)
        console.print(f"written: {written_text(self.out, clip.frames, self.export)}")
        if self.strict and checks.findings():
            sys.exit(FAULTS_FOUND)

    def _write(self, clip: ExportClip, groom: Groom, body: BodyModel, times: Stopwatch) -> None:
        def pictured(in_video: bool) -> ExportClip:
            return clip_of_pictures(clip, self.strands, groom, body, in_video)

        for path, shown in shown_in(self.out, clip, pictured):
            console.print(writing_text(path, len(clip.sequence)))
            write_output(path, shown)
            times.lap("pictures" if path.suffix.lower() in PICTURES else "files")

    def _settings(self, groom: Groom, motion: Motion, body_shape: Float[Tensor, "10"]) -> dict[str, Any]:
        """All that the frames depend on."""
        path = () if motion.translation is None else (motion.translation,)
        morphs = () if motion.morphs is None else (motion.morphs.directions, motion.morphs.weights)
        return {
            "frames": len(motion),
            "groom": array_digest(*groom.arrays().values()),
            "motion": array_digest(motion.body_pose, *path, *morphs),
            "fps": motion.fps,
            "shape": body_shape.tolist(),
            "body": None if self.body is None else file_digest(self.body),
            "draper": self._name,
            "model": self.model,
            "weights": None if self.weights is None else hashlib.sha256(self.weights.read_bytes()).hexdigest(),
            "coherent": self.coherent,
            "settle": self.settle,
            "elastic": self._elastic,
            "rest": self._rest,
            "stiffness": self.stiffness,
            "acceleration": list(self._acceleration),
            "version": version("quaffure"),
        }

    @property
    def _measures(self) -> bool:
        return self.metrics or self.reference is not None

    def _describe(self, meta: dict[str, Any]) -> None:
        """Note the body's file, and the energy that was minimized."""
        if self.body is not None:
            meta["body"] = str(self.body)
        meta["elastic"] = self._elastic
        if self._elastic == ROD:
            meta["rest"] = self._rest
        meta["stiffness"], meta["acceleration"] = self.stiffness, self._acceleration

    @property
    def _name(self) -> str:
        if self.draper is None:
            return NEURAL if self.weights or self.model else StrandNewtonDraper.name
        return self.draper

    @property
    def _elastic(self) -> str:
        return self.elastic or (ROD if self.settle else self._own_elastic)

    @property
    def _own_elastic(self) -> str:
        return elastic_model_of(self._name, self.model)

    @property
    def _rest(self) -> str:
        return self.rest or "design"

    def _check_options(self) -> None:
        """Refuse options before the work."""
        if self._name not in DRAPERS:
            raise InputError("--draper", f"one of {', '.join(DRAPERS)}", f"'{self._name}'")
        if self.settle < 0:
            raise InputError("--settle", "0 or more", f"{self.settle}")
        if self.settle and self._name == StrandNewtonDraper.name:
            raise InputError("--settle", f"another draper than {self._name}, as --draper {NEURAL}", "none")
        if self.settle and self._elastic != ROD:
            raise InputError("--settle", f"the elastic model {ROD}", f"'{self._elastic}'")
        if self.rest is not None and self._elastic != ROD:
            raise InputError("--rest", f"--elastic {ROD}", f"'{self._elastic}'")
        if self.model is not None and (self.model not in MODELS or self.weights is not None or self._name != NEURAL):
            expected = f"{' or '.join(MODELS)}, with the network and without --weights"
            raise InputError("--model", expected, f"'{self.model}', {self._name}")
        is_trained = self._name in (NEURAL, GROOMGEN)
        if is_trained and not self.settle and self.elastic not in (None, self._own_elastic):
            raise InputError("--elastic", f"{self._own_elastic} with {self._name}", f"'{self.elastic}'")
        if self._name == NEURAL and self._rest != "design":
            raise InputError("--rest", f"design with {NEURAL}", f"'{self.rest}'")
        for option, factor in (("--stiffness", self.stiffness), ("--weight", self.weight)):
            if not 0 < factor <= MOST_SCALE:
                raise InputError(option, f"a factor above 0, at most {MOST_SCALE:g}", f"{factor:g}")
        if self._name == GROOMGEN and not self.settle and not self._has_default_loading:
            expected = f"another draper, or --settle after {self._name}, which knows one hair and one gravity"
            raise InputError("--stiffness, --weight, --gravity, --wind", expected, f"'{self._name}'")
        if self._name == GROOMGEN and self.weights is None:
            raise InputError("--weights", f"weights of quaffure train-groomgen with the draper {GROOMGEN}", "none")
        if self.stiffness != 1 and self._elastic not in (ROD, MODIFIED_COSSERAT):
            raise InputError("--stiffness", f"the elastic model {ROD} or {MODIFIED_COSSERAT}", f"'{self._elastic}'")
        if self._name in SOLVERS and not self.settle:
            try:
                solver(self._name, terms=hair_terms(self._elastic, acceleration=self._acceleration))
            except InputError as refused:
                expected = f"a model that {self._name} minimizes, or --draper adam or lbfgs, which take any"
                raise InputError("--elastic", expected, f"'{self._elastic}'") from refused

    def _draper(self, groom: Groom, body: BodyModel) -> tuple[Draper, Terms]:
        """The draper by name, and the terms of the energy that is measured.

        Solvers get the material that the weights were trained for, to be comparable.
        """
        draper, _ = load_trained(self._name, self.weights or self.model)
        if isinstance(draper, NeuralDraper):
            draper = draper.with_loading(Loading(self.stiffness, self._acceleration))
        material = draper.material
        if self._elastic == MODIFIED_COSSERAT:
            material = replace(material, k_cosserat=self.stiffness * material.k_cosserat)
        terms = self._terms(groom, body, material)
        if self._name in SOLVERS:
            is_of_terms = not self.settle or self._own_elastic == ROD
            draper = solver(self._name, material, terms if is_of_terms else hair_terms(acceleration=self._acceleration))
        if self.settle:
            draper = with_settling(draper, self.settle, terms)
        return with_coherence(draper) if self.coherent else draper, terms

    @property
    def _acceleration(self) -> Acceleration:
        pairs = zip(acceleration_of(self.gravity, "--gravity"), acceleration_of(self.wind, "--wind"))
        x, y, z = (self.weight * gravity + wind for gravity, wind in pairs)
        return x, y, z

    @property
    def _has_default_loading(self) -> bool:
        return self.stiffness == 1 and np.allclose(self._acceleration, GRAVITY)

    def _terms(self, groom: Groom, body: BodyModel, material: HairMaterial) -> Terms:
        if self._elastic != ROD:
            return hair_terms(self._elastic, acceleration=self._acceleration)
        if self._rest == "stress-free":
            return hair_terms(ROD, None, self.stiffness, self._acceleration)
        design = design_of(groom, body, material)
        if bool(design.unstable.any()):
            console.print(f"{int(design.unstable.sum())} strands will not keep the design")
        return hair_terms(ROD, design, self.stiffness, self._acceleration)
