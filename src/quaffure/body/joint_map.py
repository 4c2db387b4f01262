"""Which joints of another skeleton the joints of the body take their rotations from.

As a file it is TOML: a line for each joint of the body, with the joint of the motion file, or with two of them and the
share of the second in between:

    Hips = "mixamorig:Hips"
    Neck = ["mixamorig:Spine2", "mixamorig:Neck", 0.5]
    LeftFingerBase = "mixamorig:LeftHandMiddle1"

`LeftFingerBase` and `RightFingerBase` only give the direction in which a hand points. A joint without a line moves with
its parent.
"""

import json
import tomllib
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import torch

from quaffure.errors import InputError
from quaffure.geometry.rotation import interpolate_rotations
from quaffure.types import Float, Tensor

SIDES = ("Left", "Right")
REQUIRED = (
    "Hips", "Spine1", "Head", "LeftArm", "LeftForeArm", "LeftUpLeg", "LeftLeg", "RightArm", "RightForeArm",
    "RightUpLeg", "RightLeg",
)  # fmt: skip
"""Joints of the body without which the axes and limbs of a skeleton are unknown."""
LIMB_BONES = {
    f"{side}{joint}": f"{side}{end}"
    for side in SIDES
    for joint, end in (
        ("UpLeg", "Leg"), ("Leg", "Foot"), ("Arm", "ForeArm"), ("ForeArm", "Hand"), ("Hand", "FingerBase"),
    )
}  # fmt: skip
"""Bones that point where the source's do: their joint, parents first, and the joint at their end."""
CHAINS = (
    ("Hips", "LowerBack", "Spine", "Spine1", "Neck", "Neck1", "Head"),
    *(
        ("Spine1", f"{side}Shoulder", f"{side}Arm", f"{side}ForeArm", f"{side}Hand", f"{side}FingerBase")
        for side in SIDES
    ),
    *(
        ("Hips", f"{short}HipJoint", f"{side}UpLeg", f"{side}Leg", f"{side}Foot", f"{side}ToeBase")
        for short, side in zip("LR", SIDES)
    ),
)
"""Joints of the body, each below the one before it."""
JOINTS = tuple(dict.fromkeys(joint for chain in CHAINS for joint in chain))


@dataclass(frozen=True)
class JointSource:
    """Source of the world rotation of one joint of the body.

    Attributes:
        first: joint of the source skeleton.
        second, share: another joint, and the share of the way from the first rotation to its own.
    """

    first: str
    second: str | None = None
    share: float = 0.5

    def rotation(self, world: dict[str, Float[Tensor, "f 3 3"]]) -> Float[Tensor, "f 3 3"]:
        """The rotation, from those of the source's joints by name."""
        if self.second is None:
            return world[self.first]
        first = world[self.first]
        return interpolate_rotations(first, world[self.second], torch.full(first.shape[:1], self.share).to(first))

    @property
    def joints(self) -> tuple[str, ...]:
        return (self.first,) if self.second is None else (self.first, self.second)

    def __str__(self) -> str:
        if self.second is None:
            return _quoted(self.first)
        return f"[{_quoted(self.first)}, {_quoted(self.second)}, {self.share:g}]"


JointMap = dict[str, JointSource]
"""Sources by joint of the body."""


def bundled_joint_map(name: str) -> JointMap:
    """A map of `assets/rigs.toml`."""
    table = tomllib.loads((files("quaffure") / "assets" / "rigs.toml").read_text(encoding="utf-8"))[name]
    return joint_map_from(table, name)


def joint_map_from(table: dict[str, Any], source: str) -> JointMap:
    """The map in a TOML table.

    Args:
        source: the file, for errors.

    Raises:
        InputError: a joint that the body lacks, or a value of another form.
    """
    unknown = [name for name in table if name not in JOINTS]
    if unknown:
        raise InputError(source, f"joints of the body ({', '.join(JOINTS)})", ", ".join(unknown))
    return {joint: _source(joint, value, source) for joint, value in table.items()}


def joint_map_text(joint_map: JointMap) -> str:
    """The map as the text of a TOML file; joints that are required and missing are comments."""
    lines = ["# Joint of the body = joint of the motion file, or [first, second, share of the second]."]
    for joint in JOINTS:
        if joint in joint_map:
            lines.append(f"{joint} = {joint_map[joint]}")
        elif joint in REQUIRED:
            lines.append(f'# {joint} = ""  # required')
    return "\n".join(lines) + "\n"


def _source(joint: str, value: Any, source: str) -> JointSource:
    expected = f'{joint} = "joint" or {joint} = ["first", "second", share from 0 to 1]'
    parts = value if isinstance(value, list) else [value]
    if not 1 <= len(parts) <= 3 or not all(isinstance(name, str) for name in parts[:2]):
        raise InputError(source, expected, repr(value))
    share = parts[2] if len(parts) == 3 else 0.5
    if type(share) not in (int, float) or not 0 <= share <= 1:
        raise InputError(source, expected, repr(value))
    return JointSource(parts[0], parts[1] if len(parts) > 1 else None, float(share))


def _quoted(name: str) -> str:
    return json.dumps(name, ensure_ascii=False)  # a basic string of TOML has the escapes of JSON
