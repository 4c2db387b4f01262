"""Compiled kernels of another version of the package, whose types numba cannot read back."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import quaffure
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


def test_whatever_has_a_kernel_of_own_types_has_them_checked_when_it_is_imported() -> None:
    package = Path(quaffure.__file__).parent
    modules = []
    for path in sorted(package.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        if "@njit" in text and any(isinstance(node, ast.ClassDef) for node in ast.parse(text).body):
            modules.append(".".join(("quaffure", *path.relative_to(package).with_suffix("").parts)))
    assert len(modules) > 10
    check = "\n".join(
        [
            "import sys",
            "from importlib import import_module",
            f"for module in {modules}:",
            "    for name in [name for name in sys.modules if name.startswith('quaffure')]: del sys.modules[name]",
            "    import_module(module)",
            "    checked = sys.modules['quaffure._kernel_cache'].drop_own_kernels_of_other_types.cache_info()",
            "    assert checked.currsize, module",
        ]
    )
    subprocess.run([sys.executable, "-c", check], check=True)
