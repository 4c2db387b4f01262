"""One module reads devices and number types; all others are given a backend."""

import re
from pathlib import Path

import pytest

import quaffure

SOURCE = Path(quaffure.__file__).parent
COVERED = ("scene.py", "draper.py", "drape_motion.py", "energies", "solvers", "baselines")
"""`model` follows when its pipeline has a backend."""
BRANCH = re.compile(r"\.device\.type|is_cuda|dtype [=!]=")


def branches(path: Path) -> list[str]:
    """Lines that read a device or a number type."""
    lines = path.read_text(encoding="utf-8").splitlines()
    return [f"{path.name}:{number}: {line.strip()}" for number, line in enumerate(lines, 1) if BRANCH.search(line)]


@pytest.mark.parametrize("covered", COVERED)
def test_no_module_branches_on_device_or_number_type(covered: str) -> None:
    paths = [SOURCE / covered] if covered.endswith(".py") else sorted((SOURCE / covered).rglob("*.py"))
    assert paths
    assert [line for path in paths for line in branches(path)] == []


def test_the_search_finds_the_branch_of_the_backend() -> None:
    assert len(branches(SOURCE / "backend.py")) == 1
