"""Files that a user's file names, and that are read with it."""

import json
from pathlib import Path
from urllib.parse import unquote

from quaffure.errors import InputError
from quaffure.io.gltf_document import GLTF_SUFFIXES, open_gltf
from quaffure.io.strand_process import output_of_process

USD_FILES = (".usd", ".usda", ".usdc", ".usdz")


def named_files(path: Path) -> list[Path]:
    """Layers, clips and textures of a USD file; buffers and images of a glTF file; none of other files, or of one that
    its reader will refuse."""
    suffix = path.suffix.lower()
    try:
        if suffix in USD_FILES:
            return [
                Path(name) for name in json.loads(output_of_process("quaffure.io.usd_files", path, "usd", "a USD file"))
            ]
        return _files_of_gltf(path) if suffix in GLTF_SUFFIXES else []
    except InputError:
        return []


def _files_of_gltf(path: Path) -> list[Path]:
    root = open_gltf(path).root
    entries = [entry for kind in ("buffers", "images") for entry in root.entries(kind)]
    uris = (entry.fields.get("uri") for entry in entries)
    return [path.parent / unquote(uri) for uri in uris if isinstance(uri, str) and not uri.startswith("data:")]
