"""Compiled kernels of another version of the package, whose types numba cannot read back."""

import os
from pathlib import Path

from quaffure._kernel_cache import drop_kernels_of_other_types

SOURCE = "class Strands(NamedTuple):\n    length: float\n"


def test_kernels_are_dropped_when_a_type_is_renamed_and_kept_otherwise(tmp_path: Path) -> None:
    source, index = tmp_path / "solvers" / "kernels.py", tmp_path / "solvers" / "__pycache__" / "kernels.f.nbi"
    index.parent.mkdir(parents=True)

    def after(text: str) -> bool:
        index.touch()
        source.write_text(text)
        os.utime(source, (len(text), len(text)))  # as if written at another time
        drop_kernels_of_other_types(tmp_path)
        return index.exists()

    assert not after(SOURCE)  # compiled by a version that left no note of its types
    assert after(SOURCE)
    assert after(SOURCE + "    width: float\n")
    assert not after(SOURCE.replace("Strands", "Hairs"))
    assert after(SOURCE.replace("Strands", "Hairs"))


def test_other_files_in_the_package_are_no_obstacle(tmp_path: Path) -> None:
    (tmp_path / ".#lock.py").symlink_to(tmp_path / "nowhere")
    drop_kernels_of_other_types(tmp_path)
    (tmp_path / "bytes.py").write_bytes(b"\xff")
    drop_kernels_of_other_types(tmp_path)
