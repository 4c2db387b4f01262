"""The controls of a procedural hairstyle, in the words of groom tools, and the styles that the package names."""

from dataclasses import dataclass


@dataclass(frozen=True)
class HairStyle:
    """How strands grow. Lengths in metres; the head is that of the mean body, upright.

    The direction of growth on the scalp is a sum of tangents: sideways from the parting, outwards from the crown,
    backwards and downwards, each with its weight.
    """

    length: float = 0.30
    """Of a strand where the length map is 1 [m]."""
    length_map: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    """Factors on the length at forehead, crown, sides and nape [-]."""
    length_variation: float = 0.06
    """Random part of the length [-]."""
    cut_height: float | None = None
    """Tips are cut below this height over the Head joint [m]; None leaves them."""
    root_rows: int = 56
    """Rows and columns of the grid of roots over the scalp's chart; at most one strand in a texel up to 64."""
    parting: float | None = 0.0
    """Where the hair parts, from the middle to the body's left [m]; None for no parting."""
    from_parting: float = 1.0
    """Weight of the growth sideways from the parting, fading out behind the crown [-]."""
    from_crown: float = 0.6
    """Weight of the growth outwards from the crown [-]."""
    backwards: float = 0.6
    """Weight of the growth to the back; negative combs to the front [-]."""
    lift_deg: float = 25.0
    """Angle between root and scalp [degrees]."""
    set_length: float = 0.05
    """Length over which a strand keeps its direction of growth before gravity has it [m]."""
    fall: float = 1.0
    """How far gravity turns a strand in the end: 0 not at all, 1 straight down [-]."""
    shoulder_split: float = 0.2
    """Slope by which hair from the back of the head falls backwards, and hair from the front forwards [-]."""
    stiffness_length: float = 0.025
    """Length over which a strand can turn [m]."""
    layer_thickness: float = 0.014
    """How much further from the skin the hair of the crown lies than that of the nape [m]."""
    face_opening: float = 1.0
    """Width of the region of the face that is kept free, relative to the face [-]; 0 for a fringe."""
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
    frizz: float = 0.0015
    """Slow random wander of a strand at its tip [m]."""


STYLES: dict[str, HairStyle] = {
    "long_straight": HairStyle(length=0.38, length_map=(1.0, 1.0, 1.0, 0.85)),
    "long_wavy": HairStyle(
        length=0.42, length_map=(1.0, 1.0, 1.0, 0.85), parting=0.025, curl_radius=0.011, curl_length=0.085,
        curl_start=0.12, curl_phase_variation=0.15, curl_variation=0.12, clumping=0.5, clump_spacing=0.028,
        lift_deg=32.0, layer_thickness=0.018,
    ),
    "bob": HairStyle(
        length=0.25, cut_height=-0.055, parting=0.03, length_variation=0.03, layer_thickness=0.016, clumping=0.15,
        shoulder_split=0.08,
    ),
    "short_curly": HairStyle(
        length=0.12, length_map=(0.9, 1.0, 0.75, 0.6), length_variation=0.15, parting=None, from_crown=1.0,
        backwards=0.1, lift_deg=65.0, set_length=0.035, fall=0.75, shoulder_split=0.0, curl_radius=0.0055,
        curl_length=0.021, curl_start=0.012, curl_phase_variation=0.6, clumping=0.35, clump_spacing=0.018,
    ),
}  # fmt: skip
