"""A character from a file of any format that is read here."""

from pathlib import Path

from quaffure.body.character import Character
from quaffure.errors import InputError
from quaffure.io.fbx import read_fbx
from quaffure.io.fbx_records import FBX_SUFFIX
from quaffure.io.gltf import read_gltf
from quaffure.io.gltf_document import GLTF_SUFFIXES

CHARACTER_SUFFIXES = (*GLTF_SUFFIXES, FBX_SUFFIX)


def read_character(path: Path) -> Character:
    """What a file holds of a character; its suffix, in any case, selects the format (`CHARACTER_SUFFIXES`).

    Raises:
        InputError: no such file, another suffix, or what the format's reader refuses.
    """
    suffix = path.suffix.lower()
    if suffix not in CHARACTER_SUFFIXES:
        raise InputError(path, f"a character ({', '.join(CHARACTER_SUFFIXES)})", f"suffix {path.suffix!r}")
    return read_fbx(path) if suffix == FBX_SUFFIX else read_gltf(path)
