"""Under what key a drape is kept: everything that decides it, by value.

Names of this package's classes, files and functions are no part of it: what is moved or renamed drapes as before. Its
code is stood for by `DRAPE_VERSION`, that of other classes, such as a network or an energy term of a user, is a part.
"""

import hashlib
import inspect
import json
import sys
from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import torch

from quaffure.digest import array_digest
from quaffure.draper import Draper
from quaffure.types import Float, Tensor

DRAPE_VERSION = 9
"""To be raised by whoever changes what drapers return: energies, solvers, networks' code, posing, collision."""
_KNOWN = {"quaffure", "torch", "numpy", *sys.stdlib_module_names}


def drape_key(
    draper: str, groom: str, body: str, body_pose: Float[Tensor, "81"], body_shape: Float[Tensor, "10"]
) -> str:
    """Key of one drape.

    Args:
        draper: `draper_key`.
        groom, body: their digests.
    """
    return _sha256([DRAPE_VERSION, draper, groom, body, array_digest(body_pose, body_shape)])


def draper_key(draper: Draper) -> str:
    """Key of a draper: its name, the code of classes that are not this package's, and by value its public attributes,
    material, layers and weights among them. Private attributes are left out: they hold what was computed before."""
    return _sha256(_by_value(draper))


def setting_of(draper: Draper) -> dict[str, object]:
    """Class and attributes of a draper, as JSON holds them; its material and network are left out."""
    return {"class": type(draper).__name__} | {
        name: _readable(value)
        for name, value in _public(draper).items()
        if name != "material" and not isinstance(value, torch.nn.Module)
    }


def _readable(value: Any) -> object:
    if isinstance(value, str | int | float | bool | None):
        return value
    if is_dataclass(value) and not isinstance(value, type):
        return asdict(value)
    return setting_of(value) if hasattr(value, "drape") else repr(value)


def _by_value(value: Any) -> object:
    if isinstance(value, str | int | float | bool | None):
        return value
    if isinstance(value, torch.Tensor | np.ndarray):
        return array_digest(value)
    if isinstance(value, tuple | list):
        return [_by_value(item) for item in value]
    if isinstance(value, Mapping):
        return {str(name): _by_value(item) for name, item in value.items()}
    if isinstance(value, Enum | Path | torch.dtype | torch.device):
        return str(value)
    if isinstance(value, torch.nn.Module):
        parts = [[name, _code(type(part)), type(part).__name__, part.extra_repr()] for name, part in _layers(value)]
        config, weights = _by_value(getattr(value, "config", None)), _by_value(value.state_dict())
        return {"code": _code(type(value)), "config": config, "layers": parts, "weights": weights}
    values = (
        {field.name: getattr(value, field.name) for field in fields(value)} if is_dataclass(value) else _public(value)
    )
    # A class of this package without fields, such as an energy term, differs from others in its name alone.
    if hasattr(value, "name") or not is_dataclass(value):
        values["name"] = getattr(value, "name", "")
    code = _code(type(value))
    return {name: _by_value(item) for name, item in values.items()} | ({"code": code} if code else {})


def _layers(network: torch.nn.Module) -> list[tuple[str, torch.nn.Module]]:
    """Layers without parts, and all of classes that are not this package's."""
    return [(name, part) for name, part in network.named_modules() if _code(type(part)) or not list(part.children())]


def _code(kind: type) -> list[str]:
    """Names of the classes that `kind` is made of and that are not this package's, torch's or Python's, with their
    source, where there is any."""
    others = [each for each in kind.__mro__ if each.__module__.partition(".")[0] not in _KNOWN]
    return [f"{each.__qualname__}: {_source(each)}" for each in others]


def _source(kind: type) -> str:
    try:
        return inspect.getsource(kind)
    except (OSError, TypeError):  # typed into an interpreter
        return ""


def _public(value: object) -> dict[str, Any]:
    return {name: item for name, item in vars(value).items() if not name.startswith("_")}


def _sha256(value: object) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()
