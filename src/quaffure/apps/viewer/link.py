"""Links to a view: settings of the page, and a camera, as the query of its address."""

import math
import re
from collections.abc import Mapping
from typing import Any, NamedTuple
from urllib.parse import parse_qsl, urlencode

from quaffure.apps.viewer.settings import GUIDES, JOINT_RANGES, STRAND_COUNTS, Settings
from quaffure.body.body_model import SHAPE_COUNT
from quaffure.body.motion import MAX_FRAMES
from quaffure.errors import InputError, refused

Triple = tuple[float, float, float]
PAGE = "/"
MOST_FIELDS = 64
NUMBERS: Mapping[str, int] = {**dict.fromkeys(JOINT_RANGES, 3), "gravity": 3, "wind": 3, "stiffness": 1}
"""Fields that hold this many numbers, separated by commas."""
NAMES = ("groom", "motion", "draper")
FIELDS = {*NAMES, *NUMBERS, "frame", "strands", "mark", "shape"}


class View(NamedTuple):
    """Position of a browser's camera and the point in the middle of its picture [m]."""

    position: Triple
    look_at: Triple


def link_of(settings: Settings, view: View | None = None) -> str:
    """The address of a view on the server of the page: what differs from a page that has just been opened, but groom
    and clip always.

    Args:
        view: the camera of who opens the link; without it, that of the page at its start.
    """
    start = Settings(settings.groom, settings.motion)
    fields: dict[str, str] = {"groom": settings.groom, "motion": settings.motion}
    if settings.frame:
        fields["frame"] = f"{settings.frame}"
    if settings.draper != start.draper:
        fields["draper"] = settings.draper
    if settings.strands != start.strands:
        fields["strands"] = f"{settings.strand_count or GUIDES}"
    if settings.mark_inside:
        fields["mark"] = "1"
    fields |= {joint: _text(rotation) for joint, rotation in settings.rotated_joints.items()}
    if any(settings.body_shape):
        fields["shape"] = _text(settings.body_shape)
    if settings.stiffness != start.stiffness:
        fields["stiffness"] = _text((settings.stiffness,))
    fields |= {
        name: _text(getattr(settings, name))
        for name in ("gravity", "wind")
        if getattr(settings, name) != getattr(start, name)
    }
    if view is not None:  # viser's page reads these itself
        fields |= {"initialCameraPosition": _text(view.position), "initialCameraLookAt": _text(view.look_at)}
    return f"{PAGE}?{urlencode(fields, safe=',')}"


def split_query(query: str) -> tuple[dict[str, str], str]:
    """Fields of a query that are settings of the page, and the query without them.

    Raises:
        InputError: too many fields.
    """
    with refused("link", f"at most {MOST_FIELDS} fields", ValueError):
        fields = parse_qsl(query, keep_blank_values=True, max_num_fields=MOST_FIELDS)
    own = {name: value for name, value in fields if name in FIELDS}
    return own, urlencode([(name, value) for name, value in fields if name not in FIELDS], safe=",")


def settings_of(fields: Mapping[str, str], groom: str, motion: str) -> Settings:
    """Settings of a link. What it leaves out is as on a page that has just been opened.

    Args:
        groom, motion: of a link without one.

    Raises:
        InputError: a field that is no number, or outside of the range of its widget.
    """
    numbers = {name: _numbers(name, fields[name], NUMBERS[name]) for name in NUMBERS if name in fields}
    values: dict[str, Any] = {name: fields[name] for name in NAMES if name in fields}
    values |= {name: triple for name, triple in numbers.items() if name not in JOINT_RANGES}
    if "stiffness" in values:
        (values["stiffness"],) = values["stiffness"]
    if "frame" in fields:
        values["frame"] = _frame(fields["frame"])
    if "strands" in fields:
        values["strands"] = _strands(fields["strands"])
    if "shape" in fields:
        values["body_shape"] = _numbers("shape", fields["shape"], SHAPE_COUNT)
    joints = {name: triple for name, triple in numbers.items() if name in JOINT_RANGES}
    mark = fields.get("mark") == "1"
    return Settings(**{"groom": groom, "motion": motion, "joint_rotations": joints, "mark_inside": mark, **values})


def _text(values: tuple[float, ...]) -> str:
    """Numbers with a precision of 1 mm, or of the sliders."""
    return ",".join(f"{round(value, 3):g}" for value in values)


def _numbers(name: str, text: str, count: int) -> tuple[float, ...]:
    parts = text.split(",")
    try:
        values = tuple(map(float, parts))
    except ValueError:
        values = ()
    if len(values) != count or not all(map(math.isfinite, values)):
        raise InputError(f"link: {name}", f"{count} numbers, separated by commas", f"'{text:.40}'")
    return values


def _frame(text: str) -> int:
    if not (re.fullmatch(r"\d{1,6}", text) and int(text) < MAX_FRAMES):
        raise InputError("link: frame", f"a number of a frame below {MAX_FRAMES}", f"'{text:.40}'")
    return int(text)


def _strands(text: str) -> str:
    """Name of a number of strands in the picker."""
    known = {f"{count or GUIDES}": name for name, count in STRAND_COUNTS.items() if count is not None}
    if text not in known:
        raise InputError("link: strands", f"one of {', '.join(known)}", f"'{text:.40}'")
    return known[text]
