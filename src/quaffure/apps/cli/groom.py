"""`quaffure groom new` and `quaffure groom import`: groom files of one's own."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
import tyro

from quaffure.apps.cli.console import console
from quaffure.apps.cli.style_settings import with_settings
from quaffure.apps.output_path import check_output
from quaffure.body.body_model import load_body
from quaffure.config import VERTICES_PER_STRAND
from quaffure.errors import InputError
from quaffure.hair.groom import Groom
from quaffure.hair.registration import RegistrationReport, register_groom
from quaffure.hair.resample import concatenate_strands, resample_by_arc_length, without_degenerate
from quaffure.hair.scalp_texture import select_guides
from quaffure.hair.strands import Strands
from quaffure.io.groom_file import LONGEST_STRAND, write_groom
from quaffure.io.load_groom import read_head
from quaffure.io.read_strands import read_strands
from quaffure.procedural.generator import LICENCE, make_groom
from quaffure.procedural.hair_style import STYLES

Settings = tyro.conf.UseAppendAction[tuple[tuple[str, ...], ...]]


MANY_LEFT_OUT = 0.5
"""Share of strands in the file below which thinning is told."""


@dataclass(frozen=True)
class NewGroom:
    """Grow a variant of a bundled style and write it as a groom file, to drape with `quaffure drape FILE`."""

    out: Path
    """Where to write (.npz)."""
    style: str = "long_straight"
    """The style to start from (see `quaffure grooms`)."""
    set: Annotated[Settings, tyro.conf.arg(metavar="CONTROL=VALUE ...")] = ()
    """A control of the style and its value, as in length=0.25, parting=none or fringe.sweep=0.5; several may follow one
    another. Controls are the fields of quaffure.procedural.hair_style.HairStyle, lengths in metres."""
    seed: int = 0
    """Of all that is random: another seed, other strands of the same style."""

    def run(self) -> None:
        check_output(self.out, ".npz")
        if self.style not in STYLES:
            raise InputError("--style", f"one of {', '.join(sorted(STYLES))}", repr(self.style))
        if not 0 <= self.seed < 2**63:
            raise InputError("--seed", "a whole number from 0 on", f"{self.seed}")
        style = with_settings(STYLES[self.style], tuple(setting for group in self.set for setting in group))
        with console.status("growing strands"):
            groom = make_groom(style, load_body(), self.seed)
        lengths = groom.rest_lengths
        if not len(groom) or not (torch.isfinite(lengths).all() and lengths.min() > 0):
            raise InputError("--set", "controls that grow hair", f"{len(groom)} strands, some without a length")
        if groom.strand_lengths.max() >= LONGEST_STRAND:
            raise InputError("--set", f"strands under {LONGEST_STRAND} m", f"{float(groom.strand_lengths.max()):.3g} m")
        write_groom(self.out, replace(groom, name=self.out.stem, licence=LICENCE))
        console.print(f"{self.out}: {_summary(groom)}")


@dataclass(frozen=True)
class ImportGroom:
    """Register a groom of another head, units and axes to our scalp, write it as a groom file, and say how it fits."""

    files: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="FILE")]
    """Strands: .hair, .data, .bin, .tfx, .usd, .npz. Several files are the parts of one groom."""
    out: Path
    """Where to write (.npz)."""
    head: Path | None = None
    """The head mesh (.obj) that the groom was made on, in its units and axes; helps to register it."""
    picture: Path | None = None
    """A picture (.png) of before and after: the strands as they came, and on our body."""
    licence: str = ""
    """Terms of the groom, kept in the file."""

    def run(self) -> None:
        check_output(self.out, ".npz")
        if self.picture is not None:
            check_output(self.picture, ".png")
        if not self.files:
            raise InputError("FILE", "at least one file of strands", "none")
        body = load_body()
        strands = concatenate_strands([read_strands(path) for path in self.files])
        mesh = None if self.head is None else read_head(self.head)
        with console.status("registering strands"):
            groom, report = register_groom(strands, body, self.out.stem, mesh, self.licence)
        guides = select_guides(groom)
        write_groom(self.out, guides)
        console.print(str(report))
        console.print(f"{self.out}: {_summary(guides)}, one in each texel of the scalp's texture")
        if len(guides) < MANY_LEFT_OUT * len(groom):
            left_out = len(groom) - len(guides)
            console.print(f"{left_out} strands share their texel with another and are not in the file: hair that roots")
            console.print("closely together, such as a tail, is thinned the most")
        if self.picture is not None:
            from quaffure.apps.render.pictures import Subject, write_before_after

            own = _in_our_axes(_resampled(strands), report)
            before = (
                Subject(own, _in_our_axes(mesh.vertices, report), mesh.faces) if mesh else Subject.without_mesh(own)
            )
            after = Subject(guides.rest_strands.numpy(), body.rest_vertices.numpy(), body.faces.numpy())
            write_before_after(self.picture, before, after)
            console.print(f"{self.picture}: as it came on the left, on our body on the right")


@dataclass(frozen=True)
class GroomCommand:
    """Make a groom file: a new one in a style, or one from strands of another program."""

    action: Annotated[NewGroom, tyro.conf.subcommand("new")] | Annotated[ImportGroom, tyro.conf.subcommand("import")]

    def run(self) -> None:
        self.action.run()


def _summary(groom: Groom) -> str:
    centimetres = 100 * groom.strand_lengths
    low, mean, high = (float(value) for value in (centimetres.min(), centimetres.mean(), centimetres.max()))
    return f"{len(groom)} strands of {low:.1f} to {high:.1f} cm, {mean:.1f} cm in the mean"


def _resampled(strands: Strands) -> np.ndarray:
    return resample_by_arc_length(without_degenerate(strands)[0], VERTICES_PER_STRAND)


def _in_our_axes(points: np.ndarray, report: RegistrationReport) -> np.ndarray:
    """Turned and scaled as registration did, but left in their place."""
    return (report.scale * points @ np.array(report.rotation).T).astype(np.float32)
