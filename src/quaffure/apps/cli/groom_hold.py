"""`quaffure groom hold`: hold a part of a groom to its posed direction, as a tie, a clip or gel does."""

import re
from dataclasses import dataclass, replace
from pathlib import Path

import torch
import tyro

from quaffure.apps.cli.console import console
from quaffure.body.body_model import BodyModel, load_body
from quaffure.energies.held_parts import held_up_to, released, tied_at
from quaffure.errors import InputError
from quaffure.hair.groom import Groom
from quaffure.hair.groom_checks import LONGEST_STRAND
from quaffure.io.groom_file import is_groom_file, read_source, write_groom
from quaffure.io.load_groom import load_groom
from quaffure.io.output_path import check_output
from quaffure.types import Bool, Tensor

REGIONS = {
    "all": (),
    "left": ("x>0",),
    "right": ("x<0",),
    "front": ("v<0.33",),
    "crown": ("v>0.33", "v<0.67"),
    "nape": ("v>0.67",),
}
"""Regions of the scalp by name."""
CONDITION = re.compile(r"([uvxyz])\s*([<>])\s*([-+.\deE]+)")


@dataclass(frozen=True)
class HoldGroom:
    """Hold a part of a groom: from the roots for a length, or up to a tie. Writes another groom file."""

    groom: tyro.conf.Positional[str]
    """A bundled groom, or a groom file."""
    out: Path
    """Where to write (.npz)."""
    where: tuple[str, ...] = ("all",)
    """Roots of the strands: all, left, right, front, crown or nape, or conditions such as "x>0.02" and "v<0.5"; all of
    them have to hold. u (from the right ear to the left) and v (from forehead to nape) run from 0 to 1 over the scalp,
    x (to the body's left), y (to its back) and z (up) are metres from the Head joint; the body faces -y."""
    length: float | None = None
    """Hold this length of hair from the root on [m], as gel or a clip does."""
    tie: float | None = None
    """Tie the hair at this length from the root [m]; the rest hangs free. Hair that is shorter is held to its tip."""
    release: bool = False
    """Free the hair from its ties and from all that holds it."""

    def run(self) -> None:
        check_output(self.out, ".npz", inputs=(self.groom,))
        actions = {"--length": self.length, "--tie": self.tie}
        asked = [name for name, value in actions.items() if value is not None] + ["--release"] * self.release
        if len(asked) != 1:
            raise InputError("groom hold", "one of --length, --tie and --release", ", ".join(asked) or "none")
        for name, value in actions.items():
            if value is not None and not 0 < value < LONGEST_STRAND:
                raise InputError(name, f"metres above 0 and below {LONGEST_STRAND:g}", f"{value:g}")
        body = load_body()
        groom = load_groom(self.groom, body)
        strands = strands_where(groom, body, self.where)
        if self.length is not None:
            changed = held_up_to(groom, strands, self.length)
        elif self.tie is not None:
            changed = tied_at(groom, strands, self.tie)
        else:
            changed = released(groom, strands)
        path = Path(self.groom)
        source = read_source(path) if is_groom_file(path) else None
        write_groom(self.out, replace(changed, name=self.out.stem), source)
        held = 100 * float(changed.held_edges.float().mean())
        console.print(
            f"{self.out}: changed {int(strands.sum())} of {len(groom)} strands; {held:.0f} % of all edges are held"
        )


def strands_where(groom: Groom, body: BodyModel, conditions: tuple[str, ...]) -> Bool[Tensor, " s"]:
    """Strands whose roots fulfil all conditions: names in `REGIONS`, or comparisons as in `HoldGroom.where`.

    Raises:
        InputError: another text, or no strand there.
    """
    roots = groom.rest_strands[:, 0] - body.rest_joints[body.joint_names.index("Head")]
    axes = dict(zip("uvxyz", (*groom.root_uv.unbind(1), *roots.unbind(1))))
    chosen = torch.ones(len(groom), dtype=torch.bool)
    for condition in (part for text in conditions for part in REGIONS.get(text, (text,))):
        match = CONDITION.fullmatch(condition.strip())
        try:
            axis, sign, number = match.groups() if match else ("", "", "")
            value = float(number)
        except ValueError as error:
            expected = f"one of {', '.join(REGIONS)}, or a condition such as x>0.02 or v<0.5"
            raise InputError("--where", expected, repr(condition)) from error
        chosen &= (axes[axis] > value) if sign == ">" else (axes[axis] < value)
    if not chosen.any():
        raise InputError("--where", "roots that fulfil all conditions", " ".join(conditions))
    return chosen
