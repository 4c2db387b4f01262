"""Values of the widgets of the live page, and their ranges."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from quaffure.apps.viewer.view_state import MEAN_SHAPE, NO_ROTATION, Degrees
from quaffure.body.body_model import SHAPE_COUNT
from quaffure.drapers import NEURAL
from quaffure.energies.gravity import GRAVITY, NO_ACCELERATION, Acceleration
from quaffure.energies.loading import Loading
from quaffure.errors import InputError

JOINT_RANGES = {
    "Head": 60.0,
    "Neck1": 45.0,
    "Neck": 45.0,
    "Spine1": 45.0,
    "LeftShoulder": 30.0,
    "RightShoulder": 30.0,
    "LeftArm": 90.0,
    "RightArm": 90.0,
}
"""Joints that move hair, and the range of their sliders, +- [degrees]."""
LARGEST_COEFFICIENT = 3.0
LEAST_STIFFNESS, MOST_STIFFNESS = 0.3, 3.0
"""Fine and coarse hair, as multiples of the usual stiffness."""
LARGEST_GRAVITY, LARGEST_WIND = 20.0, 10.0
"""Along an axis, +- [m/s^2]."""
AUTOMATIC, GUIDES = "automatic", "guides"
STRAND_COUNTS: Mapping[str, int | None] = {
    AUTOMATIC: None,
    GUIDES: 0,
    "5,000 strands": 5_000,
    "10,000 strands": 10_000,
    "20,000 strands": 20_000,
}
"""Strands to draw by their name in the picker: None for as many as this machine draws in time, 0 for the guides."""


@dataclass(frozen=True)
class Settings:
    """Values of the widgets.

    Attributes:
        groom, motion, draper, strands: choices of the pickers.
        frame: index in the clip.
        joint_rotations: rotation vectors about the axes of the rest pose, by joint [degrees].
        body_shape: beta [standard deviations].
        stiffness: multiple of the usual one.
        gravity, wind: along the world's axes [m/s^2].

    Raises:
        InputError: a value outside of the range of its widget, or a joint without one.
    """

    groom: str
    motion: str
    frame: int = 0
    draper: str = NEURAL
    strands: str = AUTOMATIC
    mark_inside: bool = False
    joint_rotations: Mapping[str, Degrees] = field(default_factory=dict)
    body_shape: tuple[float, ...] = MEAN_SHAPE
    stiffness: float = 1.0
    gravity: Acceleration = GRAVITY
    wind: Acceleration = NO_ACCELERATION

    def __post_init__(self) -> None:
        if self.strands not in STRAND_COUNTS:
            raise InputError("strands", f"one of {'; '.join(STRAND_COUNTS)}", f"'{self.strands}'")
        if len(self.body_shape) != SHAPE_COUNT:
            raise InputError("body shape", f"{SHAPE_COUNT} coefficients", f"{len(self.body_shape)}")
        for joint, rotation in self.joint_rotations.items():
            if joint not in JOINT_RANGES:
                raise InputError("joint", f"one of {', '.join(JOINT_RANGES)}", f"'{joint}'")
            _check_range(joint, rotation, JOINT_RANGES[joint])
        _check_range("body shape", self.body_shape, LARGEST_COEFFICIENT)
        _check_range("gravity", self.gravity, LARGEST_GRAVITY)
        _check_range("wind", self.wind, LARGEST_WIND)
        if not LEAST_STIFFNESS <= self.stiffness <= MOST_STIFFNESS:
            raise InputError("stiffness", f"{LEAST_STIFFNESS:g} to {MOST_STIFFNESS:g}", f"{self.stiffness:g}")

    @property
    def strand_count(self) -> int | None:
        """Strands to draw; None for as many as this machine draws in time, 0 for the guides."""
        return STRAND_COUNTS[self.strands]

    @property
    def loading(self) -> Loading:
        """Stiffness of the hair, and the sum of gravity and wind."""
        x, y, z = (gravity + wind for gravity, wind in zip(self.gravity, self.wind))
        return Loading(self.stiffness, (x, y, z))

    @property
    def rotated_joints(self) -> dict[str, Degrees]:
        """Rotations of the joints that are not as in the clip."""
        return {joint: rotation for joint, rotation in self.joint_rotations.items() if rotation != NO_ROTATION}


def _check_range(name: str, values: Iterable[float], limit: float) -> None:
    for value in values:
        if not -limit <= value <= limit:  # NaN, too
            raise InputError(name, f"{-limit:g} to {limit:g}", f"{value:g}")
