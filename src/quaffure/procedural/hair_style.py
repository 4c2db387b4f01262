"""The controls of a procedural hairstyle, named as in groom tools, and the styles of `assets/styles.toml`."""

import json
from dataclasses import dataclass, is_dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, get_args, get_type_hints

from quaffure.errors import InputError, refused
from quaffure.input_file import read_toml

ASSETS = Path(str(files("quaffure") / "assets"))


@dataclass(frozen=True)
class Fringe:
    """Hair of the forehead, combed to the front and cut above the eyes."""

    cut_height: float = 0.055
    """Height of the tips above the Head joint; the eyes are at 0.035, the hairline at 0.12 [m]."""
    half_width: float = 0.05
    """Half the width of the fringe at the hairline [m]."""
    depth: float = 0.05
    """Distance from the hairline to its rearmost root [m]."""
    sweep: float = 0.0
    """Slope of the combing direction towards the body's left per unit to the front [-]."""
    arch: float = 0.0
    """Extra length of its sides over its middle [m]."""


@dataclass(frozen=True)
class Clipping:
    """Hair cut very short by clippers."""

    length: float = 0.006
    """Length of the clipped hair [m]."""
    below: float | None = None
    """Roots below this height above the Head joint are clipped [m]."""
    beyond: float | None = None
    """Roots further than this from the mid-plane of the head are clipped [m]."""
    fade: float = 0.02
    """Width of the transition from clipped to long hair [m]."""


@dataclass(frozen=True)
class Tie:
    """A hair tie. Strands run along the scalp to its band, pass through it, and hang free beyond it."""

    place: tuple[float, float] = (0.5, 0.6)
    """Position of the band on the scalp chart: from right to left, from forehead to nape [-]."""
    stand_off: float = 0.018
    """Distance of the band from the skin [m]."""
    radius: float = 0.010
    """Radius of the band [m]."""
    gathers_above: float | None = None
    """Only roots above this height over the Head joint, lower at the temples, are tied [m]; None ties all."""
    side: int = 0
    """1 ties the hair of the body's left side, -1 of its right, 0 of both."""
    upwards: float = 0.0
    """Upward part of the direction in which the tail leaves the band, added to the scalp's normal [-]."""
    tail_length: float = 0.30
    """Length of the hair beyond the band [m]."""
    spread_deg: float = 17.0
    """Angle of the outermost hair to the tail's axis beyond the band; 90 or more makes a puff [degrees]."""
    bun_radius: float | None = None
    """Radius of the bun into which the tail is wound [m]; None leaves it hanging."""
    turns: float = 1.4
    """Number of turns of the tail in a bun."""


@dataclass(frozen=True)
class HairStyle:
    """The shape of a hairstyle. Lengths in metres; the head is that of the mean body, upright.

    The direction of hair on the scalp is a sum of tangents: sideways from the parting, outwards from the crown,
    backwards, sideways and around the crown, each with its weight.
    """

    length: float = 0.30
    """Length of a strand where the length map is 1 [m]."""
    length_map: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    """Factors on the length at forehead, crown, sides and nape [-]."""
    length_variation: float = 0.06
    """Random part of the length [-]."""
    layering: float = 0.0
    """Relative shortening of the shortest layer, at the crown [-]."""
    cut_height: float | None = None
    """Height above the Head joint at which tips are cut [m]; None does not cut them."""
    flat_top: float | None = None
    """Height above the Head joint at which hair is cut level from above [m]; the top of the scalp is at 0.16."""
    cut_around_ears: bool = False
    """Whether hair is cut where it would cover the ears."""
    clipping: Clipping | None = None
    """The part of the hair that is clipped short."""
    fringe: Fringe | None = None
    """Hair combed over the forehead."""
    ties: tuple[Tie, ...] = ()
    """Hair ties; a strand belongs to the first that selects it."""
    root_rows: int = 56
    """Rows and columns of the grid of roots over the scalp's chart; at most one strand in a texel up to 64."""
    parting: float | None = 0.0
    """Position of the parting, from the mid-plane to the body's left [m]; None for no parting."""
    parting_to_nape: bool = False
    """Whether the parting extends behind the crown."""
    from_parting: float = 1.0
    """Weight of the direction sideways from the parting; negative combs to it, as for a crest [-]."""
    from_crown: float = 0.6
    """Weight of the direction outwards from the crown [-]."""
    backwards: float = 0.6
    """Weight of the direction to the back; negative combs to the front [-]."""
    sideways: float = 0.0
    """Weight of the direction to the body's left [-]."""
    whorl: float = 0.0
    """Weight of the direction around the crown [-]."""
    lift_deg: float = 25.0
    """Angle between root and scalp [degrees]."""
    direction_variation_deg: float = 3.0
    """Random part of the root direction [degrees]."""
    set_length: float = 0.05
    """Length over which a strand keeps its root direction before gravity bends it down [m]."""
    fall: float = 1.0
    """Share of gravity in the final direction: 0 none, 1 straight down; negative makes hair stand up [-]."""
    hold: float = 0.0
    """Attraction of the hair to the head: 0 hangs freely, 1 is slicked to it [-]."""
    shoulder_split: float = 0.2
    """Slope at which hair of the back of the head falls backwards, and hair of the front forwards [-]."""
    stiffness_length: float = 0.025
    """Length over which a strand can bend [m]."""
    layer_thickness: float = 0.014
    """Distance from the skin that hair of the crown keeps beyond hair of the nape [m]."""
    face_opening: float = 1.0
    """Width of the region in front of the face without hair, relative to the face [-]."""
    curl_radius: float = 0.0
    """Radius of the helix about a strand's axis [m]."""
    curl_length: float = 0.05
    """Advance of one turn along the axis [m]."""
    curl_start: float = 0.04
    """Length over which a curl opens from the root [m]."""
    curl_phase_variation: float = 0.3
    """Phase range of the strands in one clump, as a share of a turn [-]."""
    curl_variation: float = 0.2
    """Random part of radius and of length of the curls [-]."""
    clump_spacing: float = 0.02
    """Distance between clumps at the roots [m]."""
    clumping: float = 0.3
    """Attraction of the tips of a clump to its centre: 0 none, 1 complete [-]."""
    clump_profile: float = 1.3
    """Exponent of the clumping along a strand; below 1 the clump closes near the root [-]."""
    frizz: float = 0.0015
    """Amplitude of the random waves of a strand at its tip [m]."""


def read_styles(path: Path) -> dict[str, HairStyle]:
    """The styles of a TOML file: one table a style, with the controls that differ from their defaults.

    Raises:
        InputError: the file is not TOML, or has an unknown control or a value of the wrong type.
    """
    tables = read_toml(path, "a TOML file")
    with refused(path, "a TOML file", ValueError):  # numbers too long for Python to write
        return {name: _style_part(HairStyle, table, f"{path.name}: {name}") for name, table in tables.items()}


def style_sizes() -> dict[str, dict[str, float]]:
    """Number `strands` of the guides and their mean length `length_m` [m], by style with seed 0, without generating
    them; written by `scripts/measure_styles.py`.
    """
    sizes: dict[str, dict[str, float]] = json.loads((ASSETS / "style_sizes.json").read_text(encoding="utf-8"))
    return sizes


def _style_part(kind: Any, table: Any, source: str) -> Any:
    """A `HairStyle`, or one of its parts, from a table of the file."""
    if not isinstance(table, dict):
        raise InputError(source, "a table of controls", repr(table))
    hints = get_type_hints(kind)
    for name in table.keys() - hints.keys():
        raise InputError(source, f"one of the controls {', '.join(hints)}", repr(name))
    return kind(**{name: _control_value(hints[name], value, f"{source}.{name}") for name, value in table.items()})


def _control_value(hint: Any, value: Any, source: str) -> Any:
    options = get_args(hint)
    part = next((kind for kind in (hint, *options) if is_dataclass(kind)), None)
    if part and isinstance(value, dict):
        return _style_part(part, value, source)
    if isinstance(value, list) and (part or len(value) == len(options)):
        return tuple(_control_value(part or float, item, source) for item in value)
    if value == "none" and type(None) in options:
        return None
    if type(value) is hint or (type(value) is float and float in options and type(None) in options):
        return value
    raise InputError(source, getattr(hint, "__name__", str(hint)), repr(value))


STYLES = read_styles(ASSETS / "styles.toml")
"""Procedural grooms by name."""

HELD_OUT = ("side_part_lob", "mullet", "short_coils")
"""Names of procedural grooms that no training ever uses: one straight, one wavy, one coily."""
