import importlib
import re
from pathlib import Path

import pytest

NOTES = (Path(__file__).parents[1] / "docs" / "paper_notes.md").read_text()
SYMBOLS = sorted(set(re.findall(r"`(quaffure(?:\.\w+)+)`", NOTES)))


def test_the_notes_name_symbols_and_every_equation() -> None:
    assert len(SYMBOLS) > 20
    for equation in (1, *range(6, 15)):
        assert f"| Eq. {equation} |" in NOTES
    assert "| Eq. 2, Eq. 3, Eq. 4, Eq. 5 |" in NOTES


@pytest.mark.parametrize("symbol", SYMBOLS)
def test_every_symbol_exists(symbol: str) -> None:
    module, _, name = symbol.rpartition(".")
    assert hasattr(importlib.import_module(module), name)
