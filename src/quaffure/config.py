"""Physical parameters, one set for every groom, pose and body."""

from dataclasses import dataclass, fields

STANDARD_GRAVITY = 9.81
"""Gravitational acceleration [m/s^2]."""

BENDING_STIFFNESS, TWISTING_STIFFNESS = 8.0e-9, 8.0e-9 / 1.35
"""EI and GJ of the rod, a human hair's [N m^2]; `Loading.stiffness` and `Groom.stiffness_scale` multiply them."""

VERTICES_PER_STRAND = 24
"""N of the paper."""

EDGES_PER_STRAND = VERTICES_PER_STRAND - 1

TEXTURE_SIZE = 64
"""T of the paper."""

LARGEST_STIFFNESS, LARGEST_HAIR_LENGTH = 1e12, 1.0
"""Limits of what a material may hold: every stiffness, in its own unit, and density; every length [m]."""
LENGTHS = ("collision_margin", "smoothing_length")


@dataclass(frozen=True)
class HairMaterial:
    """What a strand is made of and how it meets the body and other strands.

    The stiffnesses are those of the paper's equations, which prints no values; `docs/paper_notes.md` says how these
    were chosen. They are never tuned for one groom or one pose.

    Raises:
        ValueError: a value that is not a finite number of 0 or more (`linear_density` and `smoothing_length`: above 0)
            or beyond its limit. Tensors, which a derivative is taken with respect to, are not checked.
    """

    linear_density: float = 6.5e-6
    """Mass of a strand per length [kg/m]; a human hair weighs 6.4e-5 N/m."""
    k_cosserat: float = 2e-7
    """Stiffness of the modified stretch-shear energy, Eq. 6 [J]."""
    k_stretch: float = 1.0
    """Stiffness of an edge against stretching, Eq. 7 [N/m]."""
    k_body_collision: float = 10.0
    """Stiffness of the contact with the body, Eq. 10 [J/m^3]."""
    collision_margin: float = 3e-3
    """Distance D kept from the body, Eq. 10 [m]."""
    collision_ramp: float = 0.25
    """The margin grows from the root by this much per length of strand up to D: a root lies on the skin."""
    k_self_collision: float = 1e-6
    """Stiffness against density above that at rest, Eq. 11 [J (m^3/kg)^3]."""
    smoothing_length: float = 5e-3
    """Smoothing length h of the density, Eqs. 12-13; the support is 2h [m]."""
    k_pose_reg: float = 3e-4
    """Stiffness of the pose regularization, Eq. 14 [J/m^2]."""

    def __post_init__(self) -> None:
        for name in (field.name for field in fields(self)):
            value, most = getattr(self, name), LARGEST_HAIR_LENGTH if name in LENGTHS else LARGEST_STIFFNESS
            if hasattr(value, "requires_grad"):
                continue
            is_number = isinstance(value, int | float) and not isinstance(value, bool)
            is_divisor = name in ("linear_density", "smoothing_length")
            if not is_number or not 0 <= value <= most or (is_divisor and value == 0):
                raise ValueError(f"expected {name} from 0 to {most:g}, found {value!r:.60}")
