"""Files that an OpenUSD file names, listed by a process of its own: `python -m quaffure.io.usd_files FILE`."""

import json
import sys
from pathlib import Path

from pxr import Ar, Sdf, Tf, UsdUtils, Work

from quaffure.input_file import check_no_stream
from quaffure.io.strand_process import serve

EXPECTED = "a USD file whose layers are files"


def main(path: Path) -> int:
    """List files for the process that started this one."""
    Work.SetConcurrencyLimit(1)
    return serve(path, named_files, lambda files, output: output.write(json.dumps([*files]).encode()))


def named_files(path: Path) -> dict[str, Sdf.Layer | None]:
    """Sublayers, references, payloads, value clips and textures of a stage, and of its layers in turn, and the layers
    among them open: a stage that is opened while they are does not read them again.

    Raises:
        InputError: one of them is a FIFO, socket or device.
    """
    files: dict[str, Sdf.Layer | None] = {}
    waiting = [str(path)]
    while waiting:
        file = waiting.pop()
        if file in files:
            continue
        check_no_stream(Path(file), EXPECTED)
        layer = files[file] = _opened(file)
        if layer is not None:
            named = (name for kind in UsdUtils.ExtractExternalReferences(file) for name in kind)
            waiting += [_file_of(Sdf.ComputeAssetPathRelativeToLayer(layer, name)) for name in named]
    return files


def _opened(file: str) -> Sdf.Layer | None:
    try:
        return Sdf.Layer.FindOrOpen(file)
    except Tf.ErrorException:  # of which the stage will speak, if it needs the layer
        return None


def _file_of(name: str) -> str:
    """The file of a layer, which may be in a package (.usdz)."""
    path, _ = Sdf.Layer.SplitIdentifier(name)
    package, _ = Ar.SplitPackageRelativePathOuter(path)
    return str(package or path)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
