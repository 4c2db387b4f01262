"""The controls of a procedural hairstyle, in the words of groom tools, and the styles that the package names."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Fringe:
    """Hair of the forehead that is combed to the front and cut there."""

    cut_height: float = 0.055
    """Tips end this far over the Head joint; the eyes lie at 0.035, the hairline at 0.12 [m]."""
    half_width: float = 0.05
    """Of the fringe at the hairline [m]."""
    depth: float = 0.05
    """How far behind the hairline its roots reach [m]."""
    sweep: float = 0.0
    """How far it is combed to the body's left for every step to the front [-]."""
    arch: float = 0.0
    """How much longer its sides are than its middle [m]."""


@dataclass(frozen=True)
class Clipping:
    """Hair that a machine has cut short."""

    length: float = 0.006
    """Of what it leaves [m]."""
    below: float | None = None
    """Roots lower than this over the Head joint are clipped [m]."""
    beyond: float | None = None
    """Roots further than this from the middle of the head are clipped [m]."""
    fade: float = 0.02
    """Over this distance clipped hair passes into long hair [m]."""


@dataclass(frozen=True)
class Tie:
    """A band that hair is gathered into. Strands run along the scalp to it, through it, and fall free."""

    place: tuple[float, float] = (0.5, 0.6)
    """Of the band on the scalp chart: from right to left, from forehead to nape [-]."""
    stand_off: float = 0.018
    """Distance of the band from the skin [m]."""
    radius: float = 0.010
    """Of the band [m]."""
    gathers_above: float | None = None
    """Only roots higher than this over the Head joint, less at the temples, are gathered [m]; None gathers all."""
    side: int = 0
    """1 gathers the body's left side, -1 its right, 0 both."""
    upwards: float = 0.0
    """How far the tail leaves the band upwards rather than away from the scalp [-]."""
    tail_length: float = 0.30
    """Of the hair beyond the band [m]."""
    spread_deg: float = 17.0
    """Angle by which the outermost hair fans out behind the band; from 90 on, a puff [degrees]."""
    bun_radius: float | None = None
    """The tail is wound into a bun of this radius round the band [m]; None lets it fall."""
    turns: float = 1.4
    """Of the tail round the band, in a bun."""


@dataclass(frozen=True)
class HairStyle:
    """How strands grow. Lengths in metres; the head is that of the mean body, upright.

    The direction of growth on the scalp is a sum of tangents: sideways from the parting, outwards from the crown,
    backwards, downwards and round the crown, each with its weight.
    """

    length: float = 0.30
    """Of a strand where the length map is 1 [m]."""
    length_map: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    """Factors on the length at forehead, crown, sides and nape [-]."""
    length_variation: float = 0.06
    """Random part of the length [-]."""
    layering: float = 0.0
    """How much shorter the shortest layer of the crown is [-]."""
    cut_height: float | None = None
    """Tips are cut below this height over the Head joint [m]; None leaves them."""
    flat_top: float | None = None
    """Hair is cut level at this height over the Head joint [m]; the scalp's highest point is at 0.16."""
    cut_around_ears: bool = False
    """Whether hair is cut where it would cover the ears."""
    clipping: Clipping | None = None
    """Where a machine has cut the hair short."""
    fringe: Fringe | None = None
    """Hair combed over the forehead."""
    ties: tuple[Tie, ...] = ()
    """Bands; a strand goes to the first that gathers it."""
    root_rows: int = 56
    """Rows and columns of the grid of roots over the scalp's chart; at most one strand in a texel up to 64."""
    parting: float | None = 0.0
    """Where the hair parts, from the middle to the body's left [m]; None for no parting."""
    parting_to_nape: bool = False
    """Whether the parting runs on behind the crown."""
    from_parting: float = 1.0
    """Weight of the growth sideways from the parting; negative combs to it, as for a crest [-]."""
    from_crown: float = 0.6
    """Weight of the growth outwards from the crown [-]."""
    backwards: float = 0.6
    """Weight of the growth to the back; negative combs to the front [-]."""
    sideways: float = 0.0
    """Weight of the growth to the body's left [-]."""
    whorl: float = 0.0
    """Weight of the growth round the crown [-]."""
    lift_deg: float = 25.0
    """Angle between root and scalp [degrees]."""
    direction_variation_deg: float = 3.0
    """Random part of the direction of growth [degrees]."""
    set_length: float = 0.05
    """Length over which a strand keeps its direction of growth before gravity has it [m]."""
    fall: float = 1.0
    """How far gravity turns a strand in the end: 0 not at all, 1 straight down; negative stands it up [-]."""
    hold: float = 0.0
    """How closely the hair follows the head: 0 falls off it, 1 is slicked to it [-]."""
    shoulder_split: float = 0.2
    """Slope by which hair from the back of the head falls backwards, and hair from the front forwards [-]."""
    stiffness_length: float = 0.025
    """Length over which a strand can turn [m]."""
    layer_thickness: float = 0.014
    """How much further from the skin the hair of the crown lies than that of the nape [m]."""
    face_opening: float = 1.0
    """Width of the region of the face that is kept free, relative to the face [-]."""
    curl_radius: float = 0.0
    """Of the helix round a strand's axis [m]."""
    curl_length: float = 0.05
    """Advance of one turn along the axis [m]."""
    curl_start: float = 0.04
    """Length over which a curl opens from the root [m]."""
    curl_phase_variation: float = 0.3
    """Share of a turn by which strands of one clump differ [-]."""
    curl_variation: float = 0.2
    """Random part of radius and of length of the curls [-]."""
    clump_spacing: float = 0.02
    """Distance between clumps at the roots [m]."""
    clumping: float = 0.3
    """How far the tips of a clump come together: 0 not at all, 1 in its middle [-]."""
    clump_profile: float = 1.3
    """Power of the share of a strand's length with which its clump closes; below 1 near the root [-]."""
    frizz: float = 0.0015
    """Slow random wander of a strand at its tip [m]."""


STYLES: dict[str, HairStyle] = {
    # Straight, long to short.
    "long_straight": HairStyle(length=0.38, length_map=(1.0, 1.0, 1.0, 0.75)),
    "long_fringe": HairStyle(
        length=0.46, length_map=(1.0, 1.0, 1.0, 0.8), length_variation=0.03, cut_height=-0.3,
        fringe=Fringe(half_width=0.062, depth=0.09), parting=None, from_crown=1.0, backwards=0.1, lift_deg=15.0,
        clumping=0.15,
    ),
    "side_part_lob": HairStyle(
        length=0.36, length_variation=0.04, cut_height=-0.115, parting=0.035, lift_deg=28.0, shoulder_split=0.1,
        layer_thickness=0.016, curl_radius=0.004, curl_length=0.12, curl_start=0.15, clumping=0.25,
    ),
    "bob": HairStyle(
        length=0.25, length_variation=0.03, cut_height=-0.055, parting=0.03, shoulder_split=0.08, layer_thickness=0.016,
        clumping=0.15,
    ),
    "bob_fringe": HairStyle(
        length=0.26, length_variation=0.03, cut_height=-0.06, fringe=Fringe(half_width=0.065, depth=0.09), parting=None,
        from_crown=1.0, backwards=0.1, lift_deg=15.0, shoulder_split=0.05, layer_thickness=0.012, clumping=0.1,
    ),
    "bowl_cut": HairStyle(
        length=0.24, length_variation=0.02, cut_height=0.045, cut_around_ears=True,
        clipping=Clipping(length=0.006, below=0.035, fade=0.01),
        fringe=Fringe(cut_height=0.052, half_width=0.08, depth=0.11), parting=None, from_crown=1.0, backwards=0.0,
        lift_deg=15.0, shoulder_split=0.0, layer_thickness=0.016, clumping=0.1,
    ),
    "pixie": HairStyle(
        length=0.07, length_map=(1.0, 1.0, 0.55, 0.5), length_variation=0.15, layering=0.2, cut_around_ears=True,
        fringe=Fringe(cut_height=0.062, half_width=0.065, sweep=0.9, depth=0.08), parting=None, from_crown=1.0,
        backwards=-0.1, whorl=0.35, lift_deg=20.0, set_length=0.035, fall=0.8, layer_thickness=0.01,
        clump_spacing=0.014, clumping=0.5,
    ),
    "slicked_back": HairStyle(
        length=0.14, length_map=(1.0, 0.55, 0.5, 0.2), length_variation=0.08, cut_around_ears=True, parting=None,
        from_crown=0.0, backwards=1.0, lift_deg=12.0, set_length=0.09, hold=0.8, layer_thickness=0.006,
        clump_spacing=0.014,
    ),
    "side_part": HairStyle(
        length=0.085, length_map=(1.0, 0.8, 0.5, 0.35), cut_around_ears=True,
        clipping=Clipping(length=0.01, below=0.05, fade=0.06), parting=0.04, from_crown=0.25, backwards=0.35,
        lift_deg=14.0, set_length=0.07, fall=0.8, hold=0.35, layer_thickness=0.01, clump_spacing=0.014,
    ),
    "quiff": HairStyle(
        length=0.105, length_map=(1.0, 0.6, 0.5, 0.4), cut_around_ears=True,
        clipping=Clipping(length=0.008, below=0.1, beyond=0.05, fade=0.02), parting_to_nape=True, from_parting=-0.9,
        from_crown=0.0, backwards=1.0, lift_deg=32.0, set_length=0.065, fall=0.8, layer_thickness=0.02,
        clump_spacing=0.018,
    ),
    "undercut": HairStyle(
        length=0.11, length_map=(1.0, 0.9, 0.9, 0.8), cut_around_ears=True,
        clipping=Clipping(length=0.005, below=0.105, fade=0.004), parting=None, from_crown=0.0, sideways=-0.9,
        lift_deg=42.0, set_length=0.07, hold=0.2, layer_thickness=0.016, clump_spacing=0.018, clumping=0.4,
    ),
    "mohawk": HairStyle(
        length=0.1, length_map=(0.9, 1.0, 1.0, 0.65), length_variation=0.12, cut_around_ears=True,
        clipping=Clipping(length=0.004, beyond=0.03, fade=0.004), parting_to_nape=True, from_parting=-1.0,
        from_crown=0.0, backwards=0.15, lift_deg=72.0, direction_variation_deg=5.0, set_length=0.2, fall=0.0,
        layer_thickness=0.0, clumping=0.45, clump_profile=0.8,
    ),
    "crew_cut": HairStyle(
        length=0.026, length_map=(1.0, 0.8, 0.35, 0.28), length_variation=0.15, cut_around_ears=True, parting=None,
        from_crown=0.4, backwards=-0.7, lift_deg=50.0, direction_variation_deg=9.0, fall=0.15, layer_thickness=0.004,
        clumping=0.15,
    ),
    # Wavy, long to short.
    "long_wavy": HairStyle(
        length=0.42, length_map=(1.0, 1.0, 1.0, 0.85), parting=0.025, lift_deg=32.0, layer_thickness=0.018,
        curl_radius=0.011, curl_length=0.085, curl_start=0.12, curl_phase_variation=0.15, curl_variation=0.12,
        clump_spacing=0.028, clumping=0.5,
    ),
    "beach_waves": HairStyle(
        length=0.36, length_map=(1.0, 1.0, 1.0, 0.8), length_variation=0.12, layering=0.2, parting=-0.02, lift_deg=30.0,
        layer_thickness=0.02, curl_radius=0.013, curl_length=0.085, curl_start=0.11, curl_phase_variation=0.08,
        clump_spacing=0.03, clumping=0.7, clump_profile=0.7, frizz=0.004,
    ),
    "layered_shag": HairStyle(
        length=0.32, length_map=(0.7, 0.75, 0.85, 1.0), length_variation=0.15, layering=0.55,
        fringe=Fringe(cut_height=0.052, half_width=0.07, depth=0.085, arch=0.05), parting=None, from_crown=1.0,
        backwards=0.2, lift_deg=28.0, layer_thickness=0.022, face_opening=0.85, curl_radius=0.006, curl_length=0.08,
        curl_start=0.08, clump_spacing=0.018, clumping=0.45,
    ),
    "wavy_bob": HairStyle(
        length=0.29, cut_height=-0.07, parting=-0.03, lift_deg=28.0, shoulder_split=0.05, curl_radius=0.009,
        curl_length=0.065, curl_start=0.07, curl_phase_variation=0.12, clump_spacing=0.022, clumping=0.45, frizz=0.003,
    ),
    "mullet": HairStyle(
        length=0.25, length_map=(0.34, 0.34, 0.2, 1.0), length_variation=0.12, layering=0.15, cut_around_ears=True,
        fringe=Fringe(cut_height=0.068, half_width=0.06, depth=0.07), parting=None, from_crown=1.0, backwards=0.5,
        lift_deg=30.0, set_length=0.04, curl_radius=0.003, curl_length=0.07, clump_spacing=0.018, clumping=0.4,
    ),
    "short_waves": HairStyle(
        length=0.085, length_map=(1.0, 0.9, 0.6, 0.5), length_variation=0.12, cut_around_ears=True, parting=-0.035,
        from_crown=0.4, backwards=0.3, lift_deg=15.0, fall=0.8, layer_thickness=0.006, curl_radius=0.004,
        curl_length=0.04, curl_start=0.03, curl_phase_variation=0.12, clump_spacing=0.016, clump_profile=0.8,
    ),
    # Curly, long to short.
    "long_ringlets": HairStyle(
        length=0.5, length_map=(1.0, 1.0, 1.0, 0.8), layer_thickness=0.02, curl_radius=0.011, curl_length=0.07,
        curl_start=0.09, curl_phase_variation=0.04, curl_variation=0.08, clump_spacing=0.032, clumping=0.8,
        clump_profile=0.45,
    ),
    "curly_bob": HairStyle(
        length_map=(0.8, 0.9, 1.0, 0.8), length_variation=0.1, parting=0.03, lift_deg=27.0, shoulder_split=0.0,
        layer_thickness=0.016, curl_radius=0.01, curl_length=0.042, curl_phase_variation=0.12, curl_variation=0.15,
        clump_spacing=0.022, clumping=0.6, clump_profile=0.6, frizz=0.004,
    ),
    "short_curly": HairStyle(
        length=0.12, length_map=(0.9, 1.0, 0.75, 0.6), length_variation=0.15, parting=None, from_crown=1.0,
        backwards=0.1, lift_deg=65.0, set_length=0.035, fall=0.75, shoulder_split=0.0, curl_radius=0.0055,
        curl_length=0.021, curl_start=0.012, curl_phase_variation=0.6, clump_spacing=0.018, clumping=0.35,
    ),
    # Kinky and coily, long to short.
    "long_coils": HairStyle(
        length=0.32, length_map=(0.9, 1.0, 1.0, 0.85), length_variation=0.12, lift_deg=27.0, set_length=0.07, fall=0.95,
        shoulder_split=0.05, layer_thickness=0.018, face_opening=0.85, curl_radius=0.008, curl_length=0.042,
        curl_start=0.02, curl_phase_variation=0.25, clumping=0.45, clump_profile=0.6, frizz=0.006,
    ),
    "afro": HairStyle(
        length=0.19, length_map=(0.85, 1.0, 1.0, 0.7), parting=None, from_crown=0.0, backwards=0.3, lift_deg=80.0,
        set_length=0.1, fall=0.05, shoulder_split=0.0, layer_thickness=0.0, curl_radius=0.006, curl_length=0.02,
        curl_start=0.01, curl_phase_variation=1.0, curl_variation=0.3, clumping=0.2, frizz=0.004,
    ),
    "high_top": HairStyle(
        length=0.17, length_map=(1.0, 1.0, 1.0, 1.0), flat_top=0.23, cut_around_ears=True,
        clipping=Clipping(length=0.006, below=0.1, fade=0.02), parting_to_nape=True, from_parting=-1.0, from_crown=0.0,
        backwards=0.0, lift_deg=45.0, set_length=0.02, fall=-4.0, layer_thickness=0.0, curl_radius=0.0045,
        curl_length=0.018, curl_start=0.01, curl_phase_variation=1.0, clumping=0.15, frizz=0.002,
    ),
    "short_coils": HairStyle(
        length=0.085, length_map=(1.0, 1.0, 0.7, 0.55), parting=None, backwards=0.0, lift_deg=75.0, fall=0.25,
        layer_thickness=0.0, curl_radius=0.0042, curl_length=0.011, curl_start=0.008, curl_phase_variation=0.35,
        curl_variation=0.25, clump_spacing=0.011, clumping=0.65, clump_profile=0.6,
    ),
    # Gathered into ties.
    "ponytail": HairStyle(
        length_variation=0.2,
        ties=(Tie(place=(0.5, 0.55), upwards=0.3, tail_length=0.32),),
        parting=None, set_length=0.04, layer_thickness=0.008, clump_spacing=0.06, clumping=0.35,
    ),
    "pigtails": HairStyle(
        length_variation=0.2,
        ties=(
            Tie(place=(0.88, 0.7), side=1, upwards=-0.5, tail_length=0.24),
            Tie(place=(0.12, 0.7), side=-1, upwards=-0.5, tail_length=0.24),
        ),
        parting_to_nape=True, set_length=0.022, layer_thickness=0.006, clump_spacing=0.06, clumping=0.35,
    ),
    "half_up": HairStyle(
        length=0.4, length_map=(1.0, 1.0, 1.0, 0.8),
        ties=(
            Tie(place=(0.5, 0.62), gathers_above=0.055, stand_off=0.012, radius=0.008, upwards=-0.8, tail_length=0.28),
        ),
        parting=None, backwards=1.0, set_length=0.022, layer_thickness=0.01, clumping=0.2,
    ),
    "top_knot": HairStyle(
        ties=(Tie(place=(0.5, 0.38), bun_radius=0.04, stand_off=0.014),),
        parting=None, layer_thickness=0.008,
    ),
    "low_bun": HairStyle(
        ties=(Tie(place=(0.5, 0.84), bun_radius=0.042, stand_off=0.014, turns=1.8, radius=0.012),),
        layer_thickness=0.008,
    ),
    "afro_puff": HairStyle(
        length_variation=0.12,
        ties=(Tie(place=(0.5, 0.42), stand_off=0.012, radius=0.018, tail_length=0.1, spread_deg=115.0),),
        parting=None, set_length=0.1, fall=0.1, layer_thickness=0.008, curl_radius=0.007, curl_length=0.035,
        curl_start=0.015, curl_phase_variation=1.0, curl_variation=0.3, clumping=0.1, frizz=0.006,
    ),
}  # fmt: skip
"""Procedural grooms by name."""

HELD_OUT = ("side_part_lob", "mullet", "short_coils")
"""Names of procedural grooms that no training ever uses: one straight, one wavy, one coily."""
