"""Settings that a file holds as JSON, as the fields of a dataclass."""

import math
from dataclasses import fields
from typing import Any, get_type_hints

from quaffure.config import HairMaterial


def known_fields(values: Any, kind: type) -> dict[str, Any]:
    """`values`, all of them fields of a dataclass, whole numbers, truth values and texts where it has these, real
    numbers finite.

    Raises:
        ValueError: no object of JSON, a field that is not known, or a value of another type.
    """
    if not isinstance(values, dict):
        raise ValueError(f"{kind.__name__} is no JSON object")
    unknown = set(values) - {field.name for field in fields(kind)}
    if unknown:
        raise ValueError(f"unknown {kind.__name__} fields {sorted(unknown)}")
    hints = get_type_hints(kind)
    for name, value in values.items():
        if not _has_type(value, hints[name]):
            raise ValueError(f"expected {name} to be {hints[name].__name__}, found {value!r:.60}")
    return values


def material_from(values: Any) -> HairMaterial:
    """A material from what a file holds.

    Raises:
        ValueError: an unknown field, or a value that `HairMaterial` refuses.
    """
    return HairMaterial(**known_fields(values, HairMaterial))


def _has_type(value: Any, hint: Any) -> bool:
    """Whether a value of JSON may stand in a field; fields of other types than numbers and texts check their
    own values."""
    if hint is float:
        return type(value) in (int, float) and abs(value) < math.inf
    return type(value) is hint if hint in (int, bool, str) else True
