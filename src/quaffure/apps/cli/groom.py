"""`quaffure grooms`: the bundled grooms; `quaffure groom new`, `import` and `hold`: groom files of the user."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro

from quaffure.apps.cli.console import console, print_json, print_rows, progress_bar
from quaffure.apps.cli.groom_hold import HoldGroom
from quaffure.apps.cli.groom_report import print_report, print_shared_texels
from quaffure.apps.cli.outputs import check_packages
from quaffure.apps.cli.style_settings import with_settings
from quaffure.body.body_model import BodyModel, load_body
from quaffure.config import VERTICES_PER_STRAND
from quaffure.energies.held_parts import with_found_ties
from quaffure.errors import InputError
from quaffure.hair.file_frame import FileFrame
from quaffure.hair.groom import Groom
from quaffure.hair.groom_checks import check_values
from quaffure.hair.registration import HeadMesh
from quaffure.hair.registration_report import RegistrationReport
from quaffure.hair.resample import concatenate_strands, resample_by_arc_length, without_degenerate
from quaffure.hair.scalp_texture import select_guides
from quaffure.hair.source_strands import place_strands
from quaffure.hair.strands import Strands
from quaffure.io.groom_file import write_groom
from quaffure.io.load_groom import read_head, register_strands
from quaffure.io.output_path import check_output
from quaffure.io.read_strands import read_strands
from quaffure.procedural.generator import LICENCE, make_groom
from quaffure.procedural.hair_style import HELD_OUT, STYLES, style_sizes

Settings = tyro.conf.UseAppendAction[tuple[tuple[str, ...], ...]]


HELD_COLOUR = (0.02, 0.09, 0.35)
"""Colour of held parts in pictures, linear RGB."""
FILLED = {"width": ("widths", "the median"), "colour": ("colours", "the mean")}
"""Attributes that strands of a file without them get from other files: what they are, and what is taken."""


@dataclass(frozen=True)
class GroomsCommand:
    """The bundled grooms."""

    json: bool = False
    """Print JSON instead of a table."""
    out: Path | None = None
    """Draw them all to this picture (.png), each from three sides."""

    def run(self) -> None:
        console.quiet = self.json
        if self.out is not None:
            check_output(self.out, ".png")
            check_packages(self.out)
            _draw_styles(self.out)
        rows = [_style_row(name, size) for name, size in style_sizes().items()]
        print_json(rows) if self.json else print_rows(rows, "bundled grooms")


@dataclass(frozen=True)
class NewGroom:
    """Make a variant of a bundled style and write it as a groom file, to drape with `quaffure drape FILE`."""

    out: Path
    """Where to write (.npz)."""
    style: str = "long_straight"
    """The style to start from (see `quaffure grooms`)."""
    set: Annotated[Settings, tyro.conf.arg(metavar="CONTROL=VALUE ...")] = ()
    """A control of the style and its value, as in length=0.25, parting=none or fringe.sweep=0.5; several may follow one
    another. Controls are the fields of quaffure.procedural.hair_style.HairStyle, lengths in metres."""
    seed: int = 0
    """Random seed: another one makes other strands of the same style."""

    def run(self) -> None:
        check_output(self.out, ".npz")
        if self.style not in STYLES:
            raise InputError("--style", f"one of {', '.join(sorted(STYLES))}", repr(self.style))
        if not 0 <= self.seed < 2**63:
            raise InputError("--seed", "a whole number from 0 on", f"{self.seed}")
        style = with_settings(STYLES[self.style], tuple(setting for group in self.set for setting in group))
        with console.status("making strands"):
            groom = make_groom(style, load_body(), self.seed)
        if not len(groom):
            raise InputError("--set", "controls that make hair", "no strands")
        check_values(groom, "--set")
        write_groom(self.out, replace(groom, name=self.out.stem, licence=LICENCE))
        console.print(f"{self.out}: {_summary(groom)}")


@dataclass(frozen=True)
class ImportGroom:
    """Register a groom of another head, units and axes to our scalp, write it as a groom file, and report the fit."""

    files: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="FILE")]
    """Strands: .abc, .bin, .data, .hair, .npy, .npz, .ply, .tfx, .usd. Several files are the parts of one groom."""
    out: Path
    """Where to write (.npz)."""
    head: Path | None = None
    """The head mesh (.obj, .ply) that the groom was made on, in its units and axes; helps to register it."""
    up: str = ""
    """Axis of the files that points up, as in +y or z; guessed without it."""
    forward: str = ""
    """Axis of the files that the face is turned to; guessed without it."""
    units: str = ""
    """Unit of the files: m, cm, mm, inch, or the metres in one unit as a number; guessed without it."""
    mirror: bool = False
    """The files are left-handed, as those of Unreal and DirectX."""
    registered: bool = False
    """The groom stands on this body already: nothing is moved. Without --up, --forward and --units it is in metres,
    z up, facing -y."""
    parts: Literal["keep", "drop"] = "keep"
    """What becomes of a beard, eyebrows and strands too far from the scalp, which are not draped: they move with the
    skin where `quaffure drape --strands original` shows all strands of the files, or are left out."""
    body: Path | None = None
    """A body of your own (.npz, from `quaffure body import`) instead of the shipped one."""
    picture: Path | None = None
    """A picture (.png) of before and after: the strands as in the file, and on our body."""
    licence: str = ""
    """Terms of the groom, kept in the file."""
    ties: Literal["auto", "none"] = "auto"
    """Find ties: places where strands from all over a part of the scalp come together. Ties that the file has are
    always kept."""

    def run(self) -> None:
        inputs = (*self.files, self.head, self.body)
        check_output(self.out, ".npz", inputs=inputs)
        if self.picture is not None:
            check_output(self.picture, ".png", inputs=inputs)
            check_packages(self.picture)
        if not self.files:
            raise InputError("FILE", "at least one file of strands", "none")
        frame = FileFrame(self.up, self.forward, self.units, self.mirror, self.registered)
        body = load_body(self.body)
        parts = [read_strands(path) for path in self.files]
        strands = concatenate_strands(parts)
        mesh = None if self.head is None else read_head(self.head)
        with console.status("registering strands"):
            groom, strands, report = register_strands(strands, body, self.out.stem, mesh, frame)
        is_searched = self.ties == "auto" or groom.tie_vertex is not None
        groom, ties = with_found_ties(groom) if is_searched else (groom, "ties were not searched for")
        groom = replace(groom, licence=self.licence)
        guides = select_guides(groom)
        source = place_strands(strands, report, body)
        write_groom(self.out, guides, source if self.parts == "keep" else source.select(source.on_scalp))
        print_report(report)
        console.print(ties)
        for note in _filled(parts):
            console.print(note)
        print_shared_texels(report.kept, len(guides))
        console.print(f"{self.out}: {_summary(guides)}")
        if self.picture is not None:
            self._draw(self.picture, strands, mesh, guides, report, body)

    def _draw(
        self,
        picture: Path,
        strands: Strands,
        mesh: HeadMesh | None,
        guides: Groom,
        report: RegistrationReport,
        body: BodyModel,
    ) -> None:
        from quaffure.apps.render.pictures import Subject, write_before_after

        own = _in_our_axes(_resampled(strands), report)
        before = Subject(own, _in_our_axes(mesh.vertices, report), mesh.faces) if mesh else Subject.without_mesh(own)
        after = Subject(guides.rest_strands.numpy(), body.rest_vertices.numpy(), body.faces.numpy())
        held = held_parts_of_strands(guides)
        marked = [after._replace(strands=held, colour=HELD_COLOUR)] if len(held) else []
        write_before_after(picture, before, after, *marked)
        more = ", the held parts in blue" if marked else ""
        wearer = "our body" if body.origin is None else "the character"
        console.print(f"{picture}: as in the file on the left, on {wearer} to the right{more}")


@dataclass(frozen=True)
class GroomCommand:
    """Make a groom file: a new one in a style, one from strands of another program, or one with held parts."""

    action: (
        Annotated[NewGroom, tyro.conf.subcommand("new")]
        | Annotated[ImportGroom, tyro.conf.subcommand("import")]
        | Annotated[HoldGroom, tyro.conf.subcommand("hold")]
    )

    def run(self) -> None:
        self.action.run()


def _draw_styles(path: Path) -> None:
    from quaffure.apps.render.contact_sheet import write_contact_sheet

    body = load_body()
    with console.status("making the grooms"):
        grooms = [make_groom(name, body) for name in STYLES]
    lengths = {groom.name: f"{groom.strand_lengths.mean():.2f} m" for groom in grooms}
    notes = {name: f"{length}, held out" if name in HELD_OUT else length for name, length in lengths.items()}
    with progress_bar("drawing the grooms", len(grooms), transient=True) as update:
        write_contact_sheet(path, grooms, body, notes, lambda done: update(completed=done))


def _style_row(name: str, size: dict[str, float]) -> dict[str, object]:
    return {"name": name, "style": name.replace("_", " "), **size, "licence": LICENCE, "held_out": name in HELD_OUT}


def _filled(parts: Sequence[Strands]) -> list[str]:
    """What strands of some files get from the other files."""
    having = {name: sum(name in part.attributes.arrays() for part in parts) for name in FILLED}
    return [
        f"{having[name]} of {len(parts)} files have {what}: strands of the others get {value} of these"
        for name, (what, value) in FILLED.items()
        if 0 < having[name] < len(parts)
    ]


def _summary(groom: Groom) -> str:
    centimetres = 100 * groom.strand_lengths
    low, mean, high = (float(value) for value in (centimetres.min(), centimetres.mean(), centimetres.max()))
    return f"{len(groom)} strands of {low:.1f} to {high:.1f} cm, {mean:.1f} cm in the mean"


def held_parts_of_strands(groom: Groom) -> np.ndarray:
    """The held part of every strand that is held from its root on, as a strand of the same number of vertices [m]."""
    held = groom.held_edges.int().cumprod(1).sum(1).numpy()
    strands, vertices = groom.rest_strands.numpy()[held > 0], groom.rest_strands.shape[1]
    place = np.linspace(0, 1, vertices) * held[held > 0, None]
    before = place.astype(int).clip(max=vertices - 2)
    share, row = (place - before)[..., None], np.arange(len(strands))[:, None]
    return ((1 - share) * strands[row, before] + share * strands[row, before + 1]).astype(np.float32)


def _resampled(strands: Strands) -> np.ndarray:
    return resample_by_arc_length(without_degenerate(strands)[0], VERTICES_PER_STRAND)


def _in_our_axes(points: np.ndarray, report: RegistrationReport) -> np.ndarray:
    """Points with the rotation and scale of the registration, but not its translation."""
    return (report.scale * points @ report.rotation.T).astype(np.float32)
