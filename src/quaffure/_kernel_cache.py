"""Compiled kernels of other sources.

Numba keeps compiled kernels beside the sources, with an index of their types. A type that has been renamed or moved
since, by another version of the package, cannot be read back, and the kernel does not run: such an index is removed.
"""

import hashlib
import re
from contextlib import suppress
from functools import cache
from pathlib import Path

TYPES = re.compile(r"^class (\w+)\(NamedTuple\)", re.MULTILINE)
STAMP = "kernel_types"


@cache
def drop_own_kernels_of_other_types() -> None:
    """`drop_kernels_of_other_types` of this package, once in a process, before the first kernel runs.

    `quaffure.geometry` and `quaffure.body` ask for it when they are imported: every kernel that takes a type of this
    package is in a module of theirs or comes with one, and `import quaffure` alone costs nothing.
    """
    drop_kernels_of_other_types(Path(__file__).parent)


def drop_kernels_of_other_types(package: Path) -> None:
    """Remove the indices of kernels in a package whose types have other names or places than when they were compiled.

    Costs a look at the dates of all files, and reads them where one is new. Where the folder cannot be written, nothing
    happens: numba's cache is elsewhere then, and may have to be removed by hand.
    """
    stamp = package / "__pycache__" / STAMP
    with suppress(OSError, UnicodeDecodeError):  # files may come and go, and an editor's are of any kind
        sources = sorted(path for path in package.rglob("*.py") if not path.name.startswith("."))
        newest = max((source.stat().st_mtime_ns for source in sources), default=0)
        kept = stamp.read_text().split() if stamp.is_file() else []
        dates = f"{len(sources)}:{newest}"
        if kept[:1] == [dates]:
            return
        types = _types(sources, package)
        if kept[1:] != [types]:
            for index in package.rglob("__pycache__/*.nbi"):
                index.unlink(missing_ok=True)
        stamp.parent.mkdir(exist_ok=True)
        stamp.write_text(f"{dates} {types}")


def _types(sources: list[Path], package: Path) -> str:
    named = [
        f"{source.relative_to(package)}:{name}"
        for source in sources
        for name in TYPES.findall(source.read_text(encoding="utf-8"))
    ]
    return hashlib.sha256("\n".join(named).encode()).hexdigest()
