"""The groom file: a registered `Groom` as one `.npz`, readable without this package."""

from pathlib import Path

import numpy as np
import torch

from quaffure.body.body_model import BodyModel
from quaffure.errors import InputError
from quaffure.hair.groom import Groom
from quaffure.hair.groom_checks import LARGEST_COORDINATE, check_groom, check_values
from quaffure.hair.posing import rest_roots
from quaffure.hair.source_strands import PlacedStrands
from quaffure.hair.strand_attributes import POINT_ATTRIBUTES, StrandAttributes
from quaffure.hair.strands import held_parts_of
from quaffure.io.atomic import replacing
from quaffure.io.held_parts import HELD_PARTS_SPEC, checked_held_parts
from quaffure.npz import INTEGER, REAL, TEXT, Spec, array_names, read_arrays

NUMBERS: Spec = {
    "rest_strands": (("S", "N", 3), REAL),
    "root_faces": (("S",), INTEGER),
    "root_barycentric": (("S", 3), REAL),
    "root_uv": (("S", 2), REAL),
}
TEXTS = ("name", "licence")
SOURCE = "source_"
"""Prefix of the arrays of a groom's source."""
SOURCE_SPEC: Spec = {
    "points": (("P", 3), REAL),
    "counts": (("Q",), INTEGER),
    "from_tip": (("Q",), (np.bool_, *INTEGER)),
    "on_scalp": (("Q",), (np.bool_, *INTEGER)),
}
ATTRIBUTE_SPEC: Spec = {
    **{name: (("P", *shape), REAL) for name, shape in POINT_ATTRIBUTES.items()},
    "identifier": (("Q",), INTEGER),
    "group": (("Q",), INTEGER),
    "root_uv": (("Q", 2), REAL),
    "group_names": (("G",), TEXT),
}
FORMAT_VERSION = 2
"""Version 1 had no `format_version` and no held parts."""
ROOT_SLACK = 2e-3  # m: between a strand's first vertex and its root on the scalp


def write_groom(path: str | Path, groom: Groom, source: PlacedStrands | None = None) -> None:
    """Write a groom file, whole or not at all.

    Args:
        source: all strands that the groom was registered from, to drape them with it.

    Raises:
        InputError: the folder of `path` is missing or not writable, or a groom of no strands or with NaN.
    """
    path = Path(path)
    check_groom(groom)
    names = (*NUMBERS, *held_parts_of(groom))
    arrays = {name: getattr(groom, name).detach().cpu().numpy() for name in names}
    texts = {name: np.array(getattr(groom, name)) for name in TEXTS}
    if source is not None:
        arrays |= {f"{SOURCE}{name}": getattr(source, name) for name in SOURCE_SPEC}
        arrays |= {f"{SOURCE}{name}": values for name, values in source.attributes.arrays().items()}
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, format_version=np.array(FORMAT_VERSION), **texts, **arrays)  # type: ignore[arg-type]  # taken for numpy's allow_pickle


def read_source(path: str | Path) -> PlacedStrands | None:
    """The strands that a groom was registered from, where its file has them.

    Raises:
        InputError: a broken file.
    """
    path = Path(path)
    spec = {f"{SOURCE}{name}": kind for name, kind in SOURCE_SPEC.items()}
    if not array_names(path) & {*spec}:
        return None
    more = {f"{SOURCE}{name}": kind for name, kind in ATTRIBUTE_SPEC.items()}
    arrays, sizes = read_arrays(path, spec, "a groom file with its source (.npz)", more)
    counts = arrays[f"{SOURCE}counts"].astype(np.int64)
    # Also keeps their sum from wrapping round.
    if not ((counts >= 2) & (counts <= sizes["P"])).all() or counts.sum() != sizes["P"] or not len(counts):
        raise InputError(path, f"{SOURCE}counts of 2 and more that sum to {sizes['P']}", f"{counts[:4].tolist()}...")
    points = arrays[f"{SOURCE}points"].astype(np.float32)
    if np.abs(points).max() > LARGEST_COORDINATE:
        raise InputError(path, f"{SOURCE}points within +-{LARGEST_COORDINATE:g}", f"{np.abs(points).max():.3g}")
    from_tip, on_scalp = (arrays[f"{SOURCE}{name}"] != 0 for name in ("from_tip", "on_scalp"))
    attributes = {name: arrays[f"{SOURCE}{name}"] for name in ATTRIBUTE_SPEC if f"{SOURCE}{name}" in arrays}
    _check_groups(attributes, path)
    return PlacedStrands(points, counts, from_tip, on_scalp, StrandAttributes.of_arrays(attributes).usable())


def _check_groups(attributes: dict[str, np.ndarray], path: Path) -> None:
    group, names = attributes.get("group"), len(attributes.get("group_names", ()))
    if group is not None and not -1 <= group.min(initial=0) <= group.max(initial=0) < names:
        raise InputError(path, f"{SOURCE}group from -1 to {names - 1}", f"{group.min()} to {group.max()}")


def is_groom_file(path: Path) -> bool:
    """Whether a file is an `.npz` that holds a registered groom rather than strands without a body."""
    return path.suffix.lower() == ".npz" and {*NUMBERS} <= array_names(path)


def read_groom(path: str | Path, body: BodyModel) -> Groom:
    """Read a groom file of this format version or an earlier one, checking every array.

    Args:
        body: the body that the groom is registered to.

    Raises:
        InputError: no such file, not a groom file, a broken one, or one for another body.
    """
    path = Path(path)
    optional: Spec = {**HELD_PARTS_SPEC, "format_version": ((), INTEGER)}
    present = array_names(path)
    spec = {
        **NUMBERS,
        **dict.fromkeys(TEXTS, ((), TEXT)),
        **{name: optional[name] for name in optional if name in present},
    }
    arrays, sizes = read_arrays(path, spec, "a groom file (.npz)")
    _check_sizes(arrays, sizes, path)
    held_parts = checked_held_parts(
        {name: arrays[name] for name in HELD_PARTS_SPEC if name in arrays}, sizes["N"], path
    )
    if not np.isin(arrays["root_faces"], body.scalp.faces.cpu().numpy()).all():
        expected = "a groom of the body that is draped (--body BODY.npz for one of your own)"
        raise InputError(path, expected, "roots off that body's scalp")
    tensors = {name: torch.from_numpy(arrays[name].astype(np.float32)) for name in NUMBERS if name != "root_faces"}
    faces = torch.from_numpy(arrays["root_faces"].astype(np.int64))
    tensors |= {name: torch.from_numpy(values) for name, values in held_parts.items()}
    groom = Groom(name=str(arrays["name"]), licence=str(arrays["licence"]), root_faces=faces, **tensors)
    check_values(groom, path)
    _check_roots(groom, path, body)
    return groom


def _check_sizes(arrays: dict[str, np.ndarray], sizes: dict[str, int], path: Path) -> None:
    version = int(arrays.get("format_version", 1))
    if not 1 <= version <= FORMAT_VERSION:
        raise InputError(path, f"a groom file of format version 1 to {FORMAT_VERSION}", f"version {version}")
    if sizes["S"] < 1 or sizes["N"] < 2:
        raise InputError(path, "at least one strand of two vertices", f"{sizes['S']} of {sizes['N']}")
    if sizes.get("E", sizes["N"] - 1) != sizes["N"] - 1:
        raise InputError(path, f"{sizes['N'] - 1} edges a strand in its held parts", f"{sizes['E']}")


def _check_roots(groom: Groom, path: Path, body: BodyModel) -> None:
    apart = float((groom.rest_strands[:, 0] - rest_roots(groom, body.to("cpu"))).abs().max())
    if apart > ROOT_SLACK:
        raise InputError(path, f"strands that begin at their roots to {ROOT_SLACK} m", f"{apart:.3g} m apart")
