"""A continuous family of hairstyles: every control is sampled in its range, correlated ones together.

Named styles are points in the same space of controls, but are never sampled: the distribution is continuous.
"""

import math
from dataclasses import dataclass, replace

import torch

from quaffure.config import VERTICES_PER_STRAND
from quaffure.procedural.hair_style import Clipping, Fringe, HairStyle, Tie

Range = tuple[float, float]


@dataclass(frozen=True)
class CurlType:
    """Ranges of the controls of one curl type. Straighter hair is longer and lies flatter."""

    hanging_length: Range
    """Distance from root to tip, log-uniform [m]."""
    curl_radius: Range
    curl_length: Range
    curl_phase_variation: Range
    clumping: Range
    lift_deg: Range
    short_hair_fall: Range
    """`fall` of the shortest hair; the longest has 1 [-]."""


CURL_TYPES = {
    "straight": CurlType((0.02, 0.40), (0.0, 0.002), (0.08, 0.16), (0.2, 0.6), (0.05, 0.4), (10.0, 35.0), (0.3, 0.9)),
    "wavy": CurlType((0.04, 0.38), (0.003, 0.012), (0.045, 0.10), (0.05, 0.3), (0.3, 0.7), (18.0, 38.0), (0.4, 0.9)),
    "curly": CurlType((0.05, 0.32), (0.005, 0.011), (0.02, 0.06), (0.05, 0.5), (0.3, 0.8), (25.0, 60.0), (0.3, 0.8)),
    "kinky": CurlType((0.03, 0.15), (0.004, 0.007), (0.011, 0.022), (0.3, 1.0), (0.1, 0.6), (45.0, 80.0), (0.05, 0.5)),
}
"""Curl types, with equal probabilities."""

# Fewest vertices per turn of a curl: with less the polyline does not show its turns.
VERTICES_PER_TURN = 5
# Shortest hair that can be tied, longest hair that can be clipped at the sides [m].
SHORTEST_TIED, LONGEST_CLIPPED = 0.16, 0.14
# Shortest hair that can be cut to one level, and that can have a fringe [m].
SHORTEST_LEVEL, SHORTEST_FRINGE = 0.22, 0.06
# Probabilities where the length allows it [-].
TIED, CLIPPED, LEVEL, FRINGED, PARTED = 0.3, 0.35, 0.4, 0.4, 0.65
# Length from which on `fall` is 1 for every curl type [m].
HANGING = 0.25


class ControlSampler:
    """Uniform random numbers from one generator."""

    def __init__(self, generator: torch.Generator) -> None:
        self._generator = generator

    def uniform(self, limits: Range) -> float:
        low, high = limits
        return low + (high - low) * float(torch.rand((), generator=self._generator))

    def chance(self, probability: float) -> bool:
        return float(torch.rand((), generator=self._generator)) < probability


def sample_style(generator: torch.Generator) -> HairStyle:
    """A plausible hairstyle of the family; the same for the same state of the generator."""
    draw = ControlSampler(generator)
    kinds = tuple(CURL_TYPES.values())
    kind = kinds[int(torch.randint(len(kinds), (), generator=generator))]
    hanging = math.exp(draw.uniform((math.log(kind.hanging_length[0]), math.log(kind.hanging_length[1]))))
    style = _with_directions(draw, _curls(draw, kind, hanging), kind, hanging)
    if hanging >= SHORTEST_TIED and draw.chance(TIED):
        return _with_ties(draw, style, hanging)
    return _with_trimming(draw, style, hanging)


def _curls(draw: ControlSampler, kind: CurlType, hanging: float) -> HairStyle:
    radius = draw.uniform(kind.curl_radius)
    coarsest = VERTICES_PER_TURN * hanging / (VERTICES_PER_STRAND - 1)
    pitch = max(draw.uniform(kind.curl_length), coarsest)
    return HairStyle(
        length=hanging * math.hypot(1, 2 * math.pi * radius / pitch),
        curl_radius=radius,
        curl_length=pitch,
        curl_start=draw.uniform((0.4, 1.6)) * pitch,
        curl_phase_variation=draw.uniform(kind.curl_phase_variation),
        curl_variation=draw.uniform((0.05, 0.3)),
        clumping=draw.uniform(kind.clumping),
        clump_spacing=draw.uniform((0.012, 0.032)),
        clump_profile=draw.uniform((0.5, 1.4)),
        frizz=draw.uniform((0.0005, 0.005)),
    )


def _with_directions(draw: ControlSampler, style: HairStyle, kind: CurlType, hanging: float) -> HairStyle:
    short = draw.uniform(kind.short_hair_fall)
    parted = draw.chance(PARTED)
    return replace(
        style,
        parting=draw.uniform((-0.04, 0.04)) if parted else None,
        from_parting=draw.uniform((0.6, 1.2)),
        from_crown=draw.uniform((0.3, 0.9) if parted else (0.6, 1.2)),
        backwards=draw.uniform((0.2, 0.9)),
        sideways=draw.uniform((-0.3, 0.3)),
        whorl=draw.uniform((-0.4, 0.4)),
        lift_deg=draw.uniform(kind.lift_deg),
        direction_variation_deg=draw.uniform((1.0, 6.0)),
        set_length=draw.uniform((0.03, 0.08)),
        fall=short + (1 - short) * min(1.0, hanging / HANGING),
        hold=draw.uniform((0.0, 0.3)) if hanging < LONGEST_CLIPPED else 0.0,
        shoulder_split=draw.uniform((0.05, 0.25)),
        layer_thickness=draw.uniform((0.004, 0.022)) * min(1.0, hanging / LONGEST_CLIPPED),
        face_opening=draw.uniform((0.85, 1.1)),
    )


def _with_trimming(draw: ControlSampler, style: HairStyle, hanging: float) -> HairStyle:
    front, crown, side, nape = (draw.uniform(limits) for limits in ((0.6, 1.0), (0.7, 1.0), (0.5, 1.0), (0.5, 1.0)))
    level = hanging >= SHORTEST_LEVEL and draw.chance(LEVEL)
    fringe = Fringe(
        cut_height=draw.uniform((0.05, 0.075)),
        half_width=draw.uniform((0.045, 0.075)),
        depth=draw.uniform((0.05, 0.1)),
        sweep=draw.uniform((-0.9, 0.9)),
        arch=draw.uniform((0.0, 0.04)),
    )
    clipping = Clipping(
        length=draw.uniform((0.004, 0.012)), below=draw.uniform((0.03, 0.11)), fade=draw.uniform((0.004, 0.05))
    )
    return replace(
        style,
        length_map=(1.0, 1.0, 1.0, 1.0) if level else (front, crown, side, nape),
        length_variation=draw.uniform((0.02, 0.15)),
        layering=0.0 if level else draw.uniform((0.0, 0.5)),
        cut_height=draw.uniform((-0.28, -0.02)) if level else None,
        cut_around_ears=hanging < LONGEST_CLIPPED,
        fringe=fringe if hanging >= SHORTEST_FRINGE and draw.chance(FRINGED) else None,
        clipping=clipping if hanging <= LONGEST_CLIPPED and draw.chance(CLIPPED) else None,
    )


def _with_ties(draw: ControlSampler, style: HairStyle, hanging: float) -> HairStyle:
    """One tail anywhere from the crown to the nape, two tails, hair half up, or a bun, with equal probabilities."""
    form = int(draw.uniform((0.0, 4.0)))
    tie = Tie(
        place=(0.5, draw.uniform((0.36, 0.85))),
        stand_off=draw.uniform((0.014, 0.022)),
        radius=draw.uniform((0.008, 0.014)),
        gathers_above=draw.uniform((0.045, 0.09)) if form == 2 else None,
        upwards=draw.uniform((-0.4, 0.4)),
        tail_length=0.8 * hanging,
        spread_deg=draw.uniform((10.0, 45.0)),
        bun_radius=draw.uniform((0.034, 0.044)) if form == 3 else None,
        turns=draw.uniform((1.1, 1.9)),
    )
    ties: tuple[Tie, ...] = (tie,)
    if form == 1:
        across, along = draw.uniform((0.08, 0.22)), draw.uniform((0.5, 0.75))
        ties = (replace(tie, place=(1 - across, along), side=1), replace(tie, place=(across, along), side=-1))
    return replace(
        style,
        ties=ties,
        parting=style.parting if form == 2 else 0.0,
        parting_to_nape=form == 1,
        layer_thickness=0.5 * style.layer_thickness,
        set_length=draw.uniform((0.02, 0.05)),
        length_variation=draw.uniform((0.08, 0.25)),
    )
