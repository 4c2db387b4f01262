"""The Python blocks of the docs run as they are pasted, page by page, from the first block to the last."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = (
    "README.md",
    "docs/quick_start.md",
    "docs/examples.md",
    "docs/extend.md",
    "docs/grooms.md",
    "docs/groom_code.md",
)


def blocks(page: str) -> list[str]:
    return re.findall(r"^```python\n(.*?)^```$", (ROOT / page).read_text(encoding="utf-8"), re.M | re.S)


@pytest.mark.parametrize("page", PAGES)
def test_the_blocks_of_a_page_run(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {"__name__": "pasted"}
    assert blocks(page)
    for block in blocks(page):
        exec(compile(block, page, "exec"), names)
