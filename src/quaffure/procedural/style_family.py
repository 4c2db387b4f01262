"""A continuous family of hairstyles: every control drawn in its range, what belongs together drawn together.

Named styles are points of this family's space of controls, but never drawn: all its draws are continuous.
"""

import math
from dataclasses import dataclass, replace

import torch

from quaffure.config import VERTICES_PER_STRAND
from quaffure.procedural.hair_style import Clipping, Fringe, HairStyle, Tie

Range = tuple[float, float]


@dataclass(frozen=True)
class CurlType:
    """Ranges of the controls that go with one kind of hair. The straighter hair is, the longer and flatter it lies."""

    hanging_length: Range
    """From root to tip, drawn evenly in its logarithm [m]."""
    curl_radius: Range
    curl_length: Range
    curl_phase_variation: Range
    clumping: Range
    lift_deg: Range
    fall_of_short_hair: Range
    """Of the shortest hair; the longest always hangs [-]."""


CURL_TYPES = {
    "straight": CurlType((0.02, 0.40), (0.0, 0.002), (0.08, 0.16), (0.2, 0.6), (0.05, 0.4), (10.0, 35.0), (0.3, 0.9)),
    "wavy": CurlType((0.04, 0.38), (0.003, 0.012), (0.045, 0.10), (0.05, 0.3), (0.3, 0.7), (18.0, 38.0), (0.4, 0.9)),
    "curly": CurlType((0.05, 0.32), (0.005, 0.011), (0.02, 0.06), (0.05, 0.5), (0.3, 0.8), (25.0, 60.0), (0.3, 0.8)),
    "kinky": CurlType((0.03, 0.15), (0.004, 0.007), (0.011, 0.022), (0.3, 1.0), (0.1, 0.6), (45.0, 80.0), (0.05, 0.5)),
}
"""Kinds of hair, drawn with even chances."""

# A turn of a curl takes at least so many vertices, or it is drawn as a polygon without its turns.
VERTICES_OF_A_TURN = 5
# Hair of at least this length can be gathered into a tie; hair up to this length is clipped at the sides at times [m].
SHORTEST_TIED, LONGEST_CLIPPED = 0.16, 0.14
# From this length on hair may be cut to one level, and covers the forehead as a fringe [m].
SHORTEST_LEVEL, SHORTEST_FRINGE = 0.22, 0.06
# Chances where the length allows [-].
TIED, CLIPPED, LEVEL, FRINGED, PARTED = 0.3, 0.35, 0.4, 0.4, 0.65
# Hair of this length hangs as gravity has it, however short hair of its kind stands [m].
HANGING = 0.25


class Draw:
    """Random numbers in ranges, one after another from one generator."""

    def __init__(self, generator: torch.Generator) -> None:
        self._generator = generator

    def within(self, limits: Range) -> float:
        low, high = limits
        return low + (high - low) * float(torch.rand((), generator=self._generator))

    def chance(self, share: float) -> bool:
        return float(torch.rand((), generator=self._generator)) < share


def sample_style(generator: torch.Generator) -> HairStyle:
    """A plausible hairstyle out of the family; the same for the same state of the generator."""
    draw = Draw(generator)
    kinds = tuple(CURL_TYPES.values())
    kind = kinds[int(torch.randint(len(kinds), (), generator=generator))]
    hanging = math.exp(draw.within((math.log(kind.hanging_length[0]), math.log(kind.hanging_length[1]))))
    style = _combed(draw, _curled(draw, kind, hanging), kind, hanging)
    if hanging >= SHORTEST_TIED and draw.chance(TIED):
        return _tied(draw, style, hanging)
    return _cut(draw, style, hanging)


def _curled(draw: Draw, kind: CurlType, hanging: float) -> HairStyle:
    radius = draw.within(kind.curl_radius)
    coarsest = VERTICES_OF_A_TURN * hanging / (VERTICES_PER_STRAND - 1)
    pitch = max(draw.within(kind.curl_length), coarsest)
    return HairStyle(
        length=hanging * math.hypot(1, 2 * math.pi * radius / pitch),
        curl_radius=radius,
        curl_length=pitch,
        curl_start=draw.within((0.4, 1.6)) * pitch,
        curl_phase_variation=draw.within(kind.curl_phase_variation),
        curl_variation=draw.within((0.05, 0.3)),
        clumping=draw.within(kind.clumping),
        clump_spacing=draw.within((0.012, 0.032)),
        clump_profile=draw.within((0.5, 1.4)),
        frizz=draw.within((0.0005, 0.005)),
    )


def _combed(draw: Draw, style: HairStyle, kind: CurlType, hanging: float) -> HairStyle:
    short = draw.within(kind.fall_of_short_hair)
    parted = draw.chance(PARTED)
    return replace(
        style,
        parting=draw.within((-0.04, 0.04)) if parted else None,
        from_parting=draw.within((0.6, 1.2)),
        from_crown=draw.within((0.3, 0.9) if parted else (0.6, 1.2)),
        backwards=draw.within((0.2, 0.9)),
        sideways=draw.within((-0.3, 0.3)),
        whorl=draw.within((-0.4, 0.4)),
        lift_deg=draw.within(kind.lift_deg),
        direction_variation_deg=draw.within((1.0, 6.0)),
        set_length=draw.within((0.03, 0.08)),
        fall=short + (1 - short) * min(1.0, hanging / HANGING),
        hold=draw.within((0.0, 0.3)) if hanging < LONGEST_CLIPPED else 0.0,
        shoulder_split=draw.within((0.05, 0.25)),
        layer_thickness=draw.within((0.004, 0.022)) * min(1.0, hanging / LONGEST_CLIPPED),
        face_opening=draw.within((0.85, 1.1)),
    )


def _cut(draw: Draw, style: HairStyle, hanging: float) -> HairStyle:
    front, crown, side, nape = (draw.within(limits) for limits in ((0.6, 1.0), (0.7, 1.0), (0.5, 1.0), (0.5, 1.0)))
    level = hanging >= SHORTEST_LEVEL and draw.chance(LEVEL)
    fringe = Fringe(
        cut_height=draw.within((0.05, 0.075)),
        half_width=draw.within((0.045, 0.075)),
        depth=draw.within((0.05, 0.1)),
        sweep=draw.within((-0.9, 0.9)),
        arch=draw.within((0.0, 0.04)),
    )
    clipping = Clipping(
        length=draw.within((0.004, 0.012)), below=draw.within((0.03, 0.11)), fade=draw.within((0.004, 0.05))
    )
    return replace(
        style,
        length_map=(1.0, 1.0, 1.0, 1.0) if level else (front, crown, side, nape),
        length_variation=draw.within((0.02, 0.15)),
        layering=0.0 if level else draw.within((0.0, 0.5)),
        cut_height=draw.within((-0.28, -0.02)) if level else None,
        cut_around_ears=hanging < LONGEST_CLIPPED,
        fringe=fringe if hanging >= SHORTEST_FRINGE and draw.chance(FRINGED) else None,
        clipping=clipping if hanging <= LONGEST_CLIPPED and draw.chance(CLIPPED) else None,
    )


def _tied(draw: Draw, style: HairStyle, hanging: float) -> HairStyle:
    """One tail anywhere from the crown to the nape, two tails, hair half up, or a bun, with even chances."""
    form = int(draw.within((0.0, 4.0)))
    tie = Tie(
        place=(0.5, draw.within((0.36, 0.85))),
        stand_off=draw.within((0.014, 0.022)),
        radius=draw.within((0.008, 0.014)),
        gathers_above=draw.within((0.045, 0.09)) if form == 2 else None,
        upwards=draw.within((-0.4, 0.4)),
        tail_length=0.8 * hanging,
        spread_deg=draw.within((10.0, 45.0)),
        bun_radius=draw.within((0.034, 0.044)) if form == 3 else None,
        turns=draw.within((1.1, 1.9)),
    )
    ties: tuple[Tie, ...] = (tie,)
    if form == 1:
        across, along = draw.within((0.08, 0.22)), draw.within((0.5, 0.75))
        ties = (replace(tie, place=(1 - across, along), side=1), replace(tie, place=(across, along), side=-1))
    return replace(
        style,
        ties=ties,
        parting=style.parting if form == 2 else 0.0,
        parting_to_nape=form == 1,
        layer_thickness=0.5 * style.layer_thickness,
        set_length=draw.within((0.02, 0.05)),
        length_variation=draw.within((0.08, 0.25)),
    )
