"""The drape file: a `DrapeSequence` as one `.npz`, readable without this package."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from quaffure.body.pose_limits import check_body_pose, check_body_shape
from quaffure.errors import InputError
from quaffure.hair.drape_sequence import DrapeSequence
from quaffure.hair.strands import held_parts_of
from quaffure.io.atomic import replacing
from quaffure.io.held_parts import HELD_PARTS_SPEC, checked_held_parts
from quaffure.npz import INTEGER, NUMBER, TEXT, Spec, check_arrays, parts_of, read_arrays

# F frames, S strands, N vertices of a strand, E = N - 1, V body vertices, K body faces.
SPEC: Spec = {
    "strands": (("F", "S", "N", 3), NUMBER),
    "posed": (("F", "S", "N", 3), NUMBER),
    "rest_lengths": (("S", "E"), NUMBER),
    "body_vertices": (("F", "V", 3), NUMBER),
    "body_faces": (("K", 3), INTEGER),
    "body_pose": (("F", 81), NUMBER),
    "body_shape": ((10,), NUMBER),
    "fps": ((), NUMBER),
}
# Only in files of a body that moves.
TRANSLATION: Spec = {"body_translation": (("F", 3), NUMBER)}
DRAPE_FILE = "a drape file (.npz)"
LARGEST_POSITION = 1e6
"""Limit of all positions [m]: a drape in millimetres is refused elsewhere, with what is wrong."""


def write_drape(path: str | Path, seq: DrapeSequence, more: Mapping[str, np.ndarray] | None = None) -> None:
    """Write a drape file, whole or not at all.

    Args:
        more: further arrays for the file, which `read_drape` passes over.

    Raises:
        InputError: `path` cannot be written, or the sequence breaks the contract of the file.
    """
    path = Path(path)
    spec = SPEC if seq.body_translation is None else {**SPEC, **TRANSLATION}
    arrays = {name: np.asarray(getattr(seq, name), dtype=_dtype(name)) for name in spec}
    _check_meaning(arrays, check_arrays(arrays, spec, path, DRAPE_FILE), path)
    meta = np.array(json.dumps(seq.meta, ensure_ascii=False))
    with replacing(path) as temporary, temporary.open("wb") as file:
        # Not compressed: float positions shrink by a tenth at ten times the writing time.
        np.savez(file, meta=meta, **arrays, **held_parts_of(seq), **(more or {}))  # type: ignore[arg-type]  # taken for numpy's allow_pickle


def read_drape(path: str | Path) -> DrapeSequence:
    """Read a drape file, checking every key, shape and number.

    Raises:
        InputError: no such file, not a drape file, or a broken one.
    """
    path = Path(path)
    optional = {**TRANSLATION, **HELD_PARTS_SPEC}
    found, sizes = read_arrays(path, {**SPEC, "meta": ((), TEXT)}, DRAPE_FILE, optional)
    held_parts = {name: found.pop(name) for name in HELD_PARTS_SPEC if name in found}
    held_parts = checked_held_parts(held_parts, sizes["N"], path)
    meta = _parse_meta(found.pop("meta"), path)
    arrays = {name: array.astype(_dtype(name), copy=False) for name, array in found.items()}
    _check_meaning(arrays, sizes, path)
    fps = float(arrays.pop("fps"))
    return DrapeSequence(**arrays, fps=fps, meta=meta, **held_parts)


def _dtype(name: str) -> np.dtype:
    return np.dtype({"body_faces": "i4", "fps": "f8"}.get(name, "f4"))


def _parse_meta(array: np.ndarray, path: Path) -> dict[str, Any]:
    try:
        meta = json.loads(str(array))
    except (ValueError, RecursionError):  # ValueError: also a number of thousands of digits
        meta = None
    if not isinstance(meta, dict):
        raise InputError(path, "meta, a JSON object in a string", f"{str(array)[:60]!r}")
    return meta


def _check_meaning(arrays: dict[str, np.ndarray], sizes: dict[str, int], path: Path) -> None:
    if min(sizes["F"], sizes["S"]) < 1 or sizes["N"] < 2 or sizes["E"] != sizes["N"] - 1:
        raise InputError(
            path,
            "at least one frame, one strand and two vertices, with a rest length for each segment",
            f"strands {arrays['strands'].shape}, rest_lengths {arrays['rest_lengths'].shape}",
        )
    faces = arrays["body_faces"]
    if not faces.size or faces.min() < 0 or faces.max() >= sizes["V"]:
        found = f"{faces.min()}..{faces.max()}" if faces.size else "no faces"
        raise InputError(path, f"body_faces within 0..{sizes['V'] - 1}", found)
    check_body_pose(torch.from_numpy(arrays["body_pose"]), str(path))
    check_body_shape(torch.from_numpy(arrays["body_shape"]), str(path))
    for name in ("strands", "posed", "body_vertices"):
        farthest = max((float(np.abs(part).max()) for part in parts_of(arrays[name])), default=0.0)
        if farthest > LARGEST_POSITION:
            raise InputError(path, f"positions within {LARGEST_POSITION:g} m in {name}", f"{farthest:.3g} m")
    if arrays["fps"] <= 0:
        raise InputError(path, "a positive fps", f"{float(arrays['fps'])}")
