"""Whether all real numbers of what a reader returns are finite."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
import torch
from torch import nn


def not_finite(value: Any) -> str:
    """Where the first array or number with NaN or infinity is, as in `points.mean`; empty where all are finite."""
    return next(_places(value, "", {}), "")


def _places(value: Any, place: str, seen: dict[int, Any]) -> Iterator[str]:
    if isinstance(value, torch.Tensor):
        if value.is_floating_point() and not bool(torch.isfinite(value).all()):
            yield place or "tensor"
    elif isinstance(value, np.ndarray | np.generic):
        if value.dtype.kind in "fc" and not np.isfinite(value).all():
            yield place or "array"
    elif isinstance(value, float):
        if not math.isfinite(value):
            yield place or "number"
    elif id(value) not in seen:
        seen[id(value)] = value  # kept, so that no other object gets its id
        for name, part in _parts(value):
            yield from _places(part, f"{place}.{name}".lstrip("."), seen)


def _parts(value: Any) -> Iterator[tuple[object, Any]]:
    if isinstance(value, Mapping):
        yield from value.items()
    elif hasattr(value, "_fields"):  # a named tuple
        yield from zip(value._fields, value)
    elif isinstance(value, list | tuple | set | frozenset):
        yield from enumerate(value)
    elif isinstance(value, nn.Module):
        yield from value.state_dict().items()
    elif is_dataclass(value) and not isinstance(value, type):
        yield from ((field.name, getattr(value, field.name)) for field in fields(value))
    elif type(value).__module__.startswith("quaffure.") and hasattr(value, "__dict__"):
        yield from vars(value).items()
