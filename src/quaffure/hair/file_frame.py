"""What a user knows of a groom file: its axes, unit, handedness, and whether it stands on this body already."""

from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Float

from quaffure.errors import InputError

AXES = {sign + name: int(f"{sign}1") * np.eye(3)[axis] for sign in "+-" for axis, name in enumerate("xyz")}
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254}
"""Metres in one unit of a file."""
MIRROR = np.diag([-1.0, 1.0, 1.0])
"""From a left-handed file to a right-handed one; rotations that follow make it a reflection in any axis."""
LARGEST_UNIT = 1000.0  # m

Rotation = Float[np.ndarray, "3 3"]


@dataclass(frozen=True)
class FileFrame:
    """Axes and unit of a groom file, as far as they are known; what is not is estimated by a fit of roots to the scalp.

    Attributes:
        up, forward: axes of the file that point up, and that the face is turned to, as in "+y" or "y".
        units: a key of `UNITS`, or metres in one unit as a number.
        mirror: whether the file is left-handed.
        registered: whether the groom stands on this body already: nothing is moved. Without other words it is then in
            metres, z up, facing -y.

    Raises:
        InputError: no such axis or unit, or axes that are no right angle.
    """

    up: str = ""
    forward: str = ""
    units: str = ""
    mirror: bool = False
    registered: bool = False

    def __post_init__(self) -> None:
        for option, axis in (("--up", self.up), ("--forward", self.forward)):
            if axis and _signed(axis) not in AXES:
                raise InputError(option, f"one of {', '.join(AXES)}", repr(axis))
        if self.up and self.forward and _axis(self.up) @ _axis(self.forward):
            raise InputError("--forward", f"an axis across {self.up}", repr(self.forward))
        if self.units:
            self.metres_per_unit()

    def metres_per_unit(self) -> float:
        """Size of a unit that is known [m]."""
        if self.units in UNITS:
            return UNITS[self.units]
        try:
            metres = float(self.units)
        except ValueError:
            metres = 0.0
        if not 0 < metres < LARGEST_UNIT:
            raise InputError("--units", f"one of {', '.join(UNITS)}, or metres in a unit", repr(self.units))
        return metres

    def rotations(self) -> list[Rotation]:
        """Every plausible rotation from the file's axes, reflected where it is mirrored, to the body's (z up, facing
        -y)."""
        ups = [_axis(self.up)] if self.up else [AXES["+y"], AXES["+z"]]
        forwards = [_axis(self.forward)] if self.forward else list(AXES.values())
        reflected = MIRROR if self.mirror else np.eye(3)
        pairs = [(reflected @ up, reflected @ forward) for up, forward in product(ups, forwards) if not up @ forward]
        return [np.stack([np.cross(up, forward), -forward, up]) for up, forward in pairs]

    def registered_rotation(self) -> Rotation:
        """The rotation of a groom that stands on this body."""
        forward = self.forward or ("-y" if self.up in ("", "z", "+z") else "")
        known = FileFrame(self.up or "+z", forward, mirror=self.mirror)
        found = known.rotations()
        if len(found) > 1:
            raise InputError("--registered", "--forward with --up", f"--up {self.up} alone")
        return found[0]


UNKNOWN = FileFrame()


def _signed(axis: str) -> str:
    return axis if axis[:1] in "+-" else f"+{axis}"


def _axis(axis: str) -> Float[np.ndarray, "3"]:
    return AXES[_signed(axis)]
