"""The groom file: a registered `Groom` as one `.npz`, readable without this package."""

import zipfile
from pathlib import Path

import numpy as np
import torch

from quaffure.body.body_model import BodyModel
from quaffure.errors import InputError
from quaffure.hair.groom import Groom
from quaffure.io.atomic import replacing
from quaffure.npz_file import read_complete_npz

NUMBERS: dict[str, tuple[tuple[str | int, ...], str]] = {
    "rest_strands": (("S", "N", 3), "f"),
    "root_faces": (("S",), "iu"),
    "root_barycentric": (("S", 3), "f"),
    "root_uv": (("S", 2), "f"),
}
TEXTS = ("name", "licence")
ROOT_SLACK = 2e-3  # m: between a strand's first vertex and its place on the scalp
LONGEST_STRAND = 3.0  # m
BARYCENTRIC_SLACK = 1e-3


def write_groom(path: Path, groom: Groom) -> None:
    """Write a groom file, whole or not at all.

    Raises:
        InputError: the folder of `path` is missing or not writable.
    """
    arrays = {name: getattr(groom, name).detach().cpu().numpy() for name in NUMBERS}
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, name=np.array(groom.name), licence=np.array(groom.licence), **arrays)


def is_groom_file(path: Path) -> bool:
    """Whether an `.npz` holds a registered groom rather than strands of unknown place."""
    try:
        with zipfile.ZipFile(path) as archive:
            return {f"{name}.npy" for name in NUMBERS} <= set(archive.namelist())
    except (OSError, zipfile.BadZipFile):
        return False


def read_groom(path: Path, body: BodyModel) -> Groom:
    """Read a groom file, checking every array.

    Args:
        body: the body that the groom is registered to.

    Raises:
        InputError: no such file, not a groom file, a broken one, or one for another body.
    """
    arrays = read_complete_npz(path, (*NUMBERS, *TEXTS), "groom file (.npz)")
    _check_arrays(arrays, path, body)
    tensors = {name: torch.from_numpy(arrays[name].astype(np.float32)) for name in NUMBERS if name != "root_faces"}
    faces = torch.from_numpy(arrays["root_faces"].astype(np.int64))
    return Groom(name=str(arrays["name"]), licence=str(arrays["licence"]), root_faces=faces, **tensors)


def _check_arrays(arrays: dict[str, np.ndarray], path: Path, body: BodyModel) -> None:
    sizes: dict[str | int, int] = {}
    for name, (axes, kinds) in NUMBERS.items():
        array = arrays[name]
        fits = array.ndim == len(axes) and array.dtype.kind in kinds
        if not fits or any(
            size != sizes.setdefault(axis, axis if isinstance(axis, int) else size)
            for axis, size in zip(axes, array.shape)
        ):
            raise InputError(path, f"{name} of shape {axes}", f"{array.dtype} {array.shape}")
        if kinds == "f" and not np.isfinite(array).all():
            raise InputError(path, f"finite {name}", "NaN or infinity")
    for name in TEXTS:
        if arrays[name].ndim or arrays[name].dtype.kind != "U":
            raise InputError(path, f"{name}, a text", f"{arrays[name].dtype} {arrays[name].shape}")
    if sizes["S"] < 1 or sizes["N"] < 2:
        raise InputError(path, "at least one strand of two vertices", f"{sizes['S']} of {sizes['N']}")
    _check_roots(arrays, path, body)


def _check_roots(arrays: dict[str, np.ndarray], path: Path, body: BodyModel) -> None:
    if not np.isin(arrays["root_faces"], body.scalp.faces.cpu().numpy()).all():
        raise InputError(path, "roots on the scalp of this body", "faces off it")
    weights, uv = arrays["root_barycentric"], arrays["root_uv"]
    if weights.min() < -BARYCENTRIC_SLACK or np.abs(weights.sum(1) - 1).max() > BARYCENTRIC_SLACK:
        raise InputError(path, "barycentric coordinates that sum to 1", f"{weights.min():.3g}..{weights.max():.3g}")
    vertices, faces = body.rest_vertices.cpu().numpy(), body.faces.cpu().numpy()
    roots = (weights[..., None] * vertices[faces[arrays["root_faces"]]]).sum(1)
    apart = float(np.abs(arrays["rest_strands"][:, 0] - roots).max())
    if apart > ROOT_SLACK:
        raise InputError(path, f"strands that begin at their roots to {ROOT_SLACK} m", f"{apart:.3g} m apart")
    lengths = np.linalg.norm(np.diff(arrays["rest_strands"], axis=1), axis=-1)
    if not (lengths.min() > 0 and lengths.sum(1).max() < LONGEST_STRAND):
        found = f"{lengths.min():.3g} m and {lengths.sum(1).max():.3g} m"
        raise InputError(path, f"segments longer than 0 and strands under {LONGEST_STRAND} m", found)
    if uv.min() < 0 or uv.max() > 1:
        raise InputError(path, "root_uv in the unit square", f"{uv.min():.3g}..{uv.max():.3g}")
