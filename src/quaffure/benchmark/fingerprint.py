"""Fingerprints of whatever decides a drape, and what a draper's setting is in words."""

import hashlib
from dataclasses import asdict, fields, is_dataclass
from typing import Any

import numpy as np
import torch

from quaffure.benchmark.sources import sources_of
from quaffure.draper import Draper


def fingerprint(*values: object) -> str:
    """Hexadecimal SHA-256 of values: arrays, networks, dataclasses, plain values and containers of them.

    Networks and any other objects, such as drapers, also stand for `sources_of` their module: a solver whose energy
    changed is another solver. Private attributes, which hold what was computed before, are left out.
    """
    sha = hashlib.sha256()
    for value in values:
        _feed(sha, value)
    return sha.hexdigest()


def _feed(sha: Any, value: Any) -> None:
    sha.update(f"{type(value).__qualname__}:".encode())
    if isinstance(value, torch.Tensor | np.ndarray):
        array = np.ascontiguousarray(value.detach().cpu().numpy() if isinstance(value, torch.Tensor) else value)
        sha.update(f"{array.dtype}{array.shape}".encode())
        sha.update(array.tobytes())
    elif value is None or isinstance(value, str | int | float | bool):
        sha.update(repr(value).encode())
    elif isinstance(value, tuple | list):
        for item in value:
            _feed(sha, item)
    elif isinstance(value, dict):
        for name, item in value.items():
            _feed(sha, (name, item))
    elif isinstance(value, torch.nn.Module):
        _feed(sha, (sources_of(type(value).__module__), getattr(value, "config", None), dict(value.state_dict())))
    elif is_dataclass(value):
        _feed(sha, {field.name: getattr(value, field.name) for field in fields(value)})
    else:
        _feed(sha, (sources_of(type(value).__module__), _public(value)))


def _public(value: object) -> dict[str, Any]:
    return {name: item for name, item in vars(value).items() if not name.startswith("_")}


def setting_of(draper: Draper) -> dict[str, object]:
    """Class and attributes of a draper, as JSON holds them; its network is left out."""
    return {"class": type(draper).__name__} | {
        name: _in_words(value)
        for name, value in _public(draper).items()
        if name != "material" and not isinstance(value, torch.nn.Module)
    }


def _in_words(value: Any) -> object:
    if isinstance(value, str | int | float | bool | None):
        return value
    if is_dataclass(value) and not isinstance(value, type):
        return asdict(value)
    return setting_of(value) if hasattr(value, "drape") else repr(value)
