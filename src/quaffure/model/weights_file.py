"""Weights of a network in half precision, with what its reader needs to know, in one safetensors file."""

import math
from collections.abc import Collection
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import nn

from quaffure.errors import InputError, refused
from quaffure.input_file import check_input_file
from quaffure.types import Tensor

MAX_WIDTH = 4096
"""Widest layer that a file may ask for: its text must not decide how much memory is taken."""


def save_weights(path: Path, network: nn.Module, notes: dict[str, str], without: Collection[str] = ()) -> None:
    """Write weights, rounded to half precision, and texts by name.

    Args:
        without: names of weights that are left out.

    Raises:
        OSError: the disk is full, for instance.
    """
    weights = {name: value for name, value in network.state_dict().items() if name not in without}
    half = {name: value.detach().to(torch.float16).contiguous() for name, value in weights.items()}
    path.write_bytes(save(half, notes))


def read_weights(path: Path, expected: str) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Read a file of `save_weights`, in single precision: weights by name, and the texts.

    Args:
        expected: what the file should be, for the error.

    Raises:
        InputError: no such file, a broken one, or weights that are not finite.
    """
    check_input_file(path, expected)
    # Kinds of numbers that torch cannot convert raise errors of torch.
    with refused(path, expected, OSError, SafetensorError, RuntimeError), safe_open(path, framework="pt") as file:
        weights = {name: file.get_tensor(name).float() for name in file.keys()}  # noqa: SIM118
        notes = dict(file.metadata() or {})
    # NaN is the least and the most of values that hold one; `isfinite` takes twenty times as long.
    if not all(math.isfinite(bound) for value in weights.values() if value.numel() for bound in value.aminmax()):
        raise InputError(path, "finite weights", "NaN or infinity")
    return weights, notes
