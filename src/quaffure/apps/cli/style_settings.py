"""Controls of a hairstyle from what a user types: `length=0.3`, `length_map=1,1,0.8,0.5`, `fringe.sweep=0.5`."""

import re
from dataclasses import fields, is_dataclass, replace
from types import NoneType
from typing import Any, get_args, get_type_hints

from quaffure.config import TEXTURE_SIZE
from quaffure.errors import InputError
from quaffure.procedural.hair_style import HairStyle

LARGEST = 100.0
"""Limit of a control, whatever its unit; lengths are in metres."""
LONGEST = 2.0
"""Limit of hair lengths [m]: 50 is meant in centimetres."""
HAIR_LENGTHS = ("length", "tail_length")
# Controls that something is divided by, or that count.
ABOVE_ZERO = (
    "bun_radius", "clump_profile", "clump_spacing", "curl_length", "curl_start", "fade", "length", "radius",
    "root_rows", "set_length", "stiffness_length", "tail_length",
)  # fmt: skip


def with_settings(style: HairStyle, settings: tuple[str, ...]) -> HairStyle:
    """The style with some of its controls changed.

    Args:
        settings: each `control=value`; numbers of a tuple are separated by commas, `none` is no value, and a dot leads
            to the controls of a part, as in `fringe.sweep` and `ties.0.radius`.

    Raises:
        InputError: no such control, or a value that it cannot take.
    """
    for setting in settings:
        path, equals, text = setting.partition("=")
        if not equals:
            raise InputError(f"--set {setting}", "control=value", "no =")
        style = _changed(style, path.strip().split("."), text.strip(), f"--set {setting}")
    return style


def _changed(part: Any, path: list[str], text: str, source: str) -> Any:
    """A dataclass of controls, one of them changed, in it or in a part of it."""
    hints = get_type_hints(type(part))
    name, *rest = path
    if name not in hints:
        raise InputError(source, f"one of the controls {', '.join(field.name for field in fields(part))}", repr(name))
    if not rest:
        return replace(part, **{name: _value(hints[name], text, name, source)})
    inner = getattr(part, name)
    if isinstance(inner, tuple) and inner and is_dataclass(inner[0]):
        place = int(rest[0]) if re.fullmatch(r"\d{1,4}", rest[0]) else len(inner)
        if place >= len(inner) or not rest[1:]:
            raise InputError(source, f"{name}.0.CONTROL to {name}.{len(inner) - 1}.CONTROL", ".".join(path))
        changed = _changed(inner[place], rest[1:], text, source)
        return replace(part, **{name: (*inner[:place], changed, *inner[place + 1 :])})
    kinds = [kind for kind in (hints[name], *get_args(hints[name])) if isinstance(kind, type) and is_dataclass(kind)]
    if not kinds or isinstance(inner, tuple):
        raise InputError(source, f"a part of this style with controls of its own before '.{rest[0]}'", repr(name))
    return replace(part, **{name: _changed(kinds[0]() if inner is None else inner, rest, text, source)})


def _value(hint: Any, text: str, name: str, source: str) -> object:
    kinds = get_args(hint) if NoneType in get_args(hint) else (hint,)
    if text.lower() == "none" and NoneType in kinds:
        return None
    kind = next(kind for kind in kinds if kind is not NoneType)
    if text.lower() == "none" and get_args(kind)[1:] == (...,):
        return ()
    if kind is bool:
        if text.lower() not in ("true", "false"):
            raise InputError(source, "true or false", repr(text))
        return text.lower() == "true"
    if kind in (int, float):
        return _number(kind, text, name, source)
    if float not in get_args(kind):
        raise InputError(
            source, f"{name}.CONTROL=value, or none" if is_dataclass(kind) else "another control", repr(text)
        )
    words = text.split(",")
    if len(words) != len(get_args(kind)):
        raise InputError(source, f"{len(get_args(kind))} numbers separated by commas", f"{len(words)}")
    return tuple(_number(float, word, name, source) for word in words)


def _number(kind: type, text: str, name: str, source: str) -> float:
    try:
        number = kind(text)
    except ValueError as error:
        raise InputError(source, "a whole number" if kind is int else "a number", repr(text)) from error
    least = 0.0 if name in ABOVE_ZERO else -LARGEST
    if not least <= number <= LARGEST or (number == 0 and name in ABOVE_ZERO):
        raise InputError(source, f"{'above 0 and ' if least == 0 else ''}within +-{LARGEST:g}", text)
    if name in HAIR_LENGTHS and number > LONGEST:
        raise InputError(source, f"at most {LONGEST:g} m", text)
    if name == "root_rows" and number > TEXTURE_SIZE:
        raise InputError(source, f"at most {TEXTURE_SIZE}", text)
    return number
