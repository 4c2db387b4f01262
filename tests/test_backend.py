"""One module reads devices and number types; all others are given a backend."""

import re
from pathlib import Path

import pytest

import quaffure

SOURCE = Path(quaffure.__file__).parent
COVERED = ("scene.py", "draper.py", "drapers.py", "drape_motion.py", "model", "energies", "solvers", "baselines")
BRANCH = re.compile(
    r"\.device\.type|is_cuda|dtype (?:[=!]=|is)|\.device [=!]=|is_floating_point\(\) (?:and|or)|itemsize [=!]="
)
ALLOWED = (
    "with torch.autocast(code.device.type, torch.bfloat16, enabled=self._bf16):",  # torch wants the name of the device
    "if found.dtype is not expected.dtype:",  # a groom of another type is refused
    "return groom if found.device == device else self._moved.of(groom, lambda: groom.to(device))",
    "if values.itemsize == 2:",  # the size of a network's numbers in memory, which numpy has no type for
    "if features.itemsize == 2:",
    "return word if itemsize == 4 else rounded(word)",
)
"""Lines that decide nothing about how a drape is computed."""


def branches(path: Path) -> list[str]:
    """Lines that read a device or a number type."""
    lines = path.read_text(encoding="utf-8").splitlines()
    found = [(number, line.strip()) for number, line in enumerate(lines, 1) if BRANCH.search(line)]
    return [f"{path.name}:{number}: {line}" for number, line in found if line not in ALLOWED]


@pytest.mark.parametrize("covered", COVERED)
def test_no_module_branches_on_device_or_number_type(covered: str) -> None:
    paths = [SOURCE / covered] if covered.endswith(".py") else sorted((SOURCE / covered).rglob("*.py"))
    assert paths
    assert [line for path in paths for line in branches(path)] == []


def test_the_search_finds_the_branch_of_the_backend() -> None:
    assert len(branches(SOURCE / "backend.py")) == 1
