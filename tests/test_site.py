"""The documentation as a whole: nothing in it that its source has moved away from, and a search that finds words."""

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from scripts.results_table import tables, with_table

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]
MOST_PICTURE_BYTES = {"concept_": 120_000, "dance": 1_500_000}


def test_the_tables_of_results_are_those_of_the_files() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    for mark, table in tables().items():
        assert table in readme, "python scripts/results_table.py --write"
        assert with_table(readme, mark, "| new |\n").count("| new |") == 1
    with pytest.raises(AssertionError, match="solvers"):
        with_table("no marks", "solvers", "")


def test_every_equation_of_the_notes_stands_beside_its_function() -> None:
    notes, method = ((DOCS / page).read_text(encoding="utf-8") for page in ("paper_notes.md", "method.md"))
    assert covered(method) >= covered("\n".join(re.findall(r"^\| (Eqs?\. .*?) \|", notes, re.MULTILINE)))
    assert covered(method) >= set(range(1, 15))


def covered(text: str) -> set[int]:
    """Numbers of the equations that a text names."""
    found: set[int] = set()
    for first, last in re.findall(r"Eqs?\. (\d+)(?:(?:-| to | and )(\d+))?", text):
        found |= set(range(int(first), int(last or first) + 1))
    return found


def test_pictures_are_there_and_light() -> None:
    for page in PAGES:
        for link in re.findall(r"!\[[^\]]+\]\(([^)]+)\)", page.read_text(encoding="utf-8")):
            path = page.parent / link
            assert path.is_file(), f"{page.name}: {link}"
            for start, most in MOST_PICTURE_BYTES.items():
                assert not path.name.startswith(start) or path.stat().st_size <= most, link


def test_links_between_pages_lead_somewhere() -> None:
    """Those of the README; the site's build refuses others."""
    for link in re.findall(r"\]\((?!http)([^)#]+)", (ROOT / "README.md").read_text(encoding="utf-8")):
        assert (ROOT / link).exists(), link


def pages_with(word: str, index: dict[str, Any]) -> set[str]:
    """Pages that the index names for the stem of a word."""
    pages: set[str] = set()
    for term, places in index["terms"].items():
        if len(term) > 4 and word.startswith(term):
            pages |= {index["docnames"][place] for place in (places if isinstance(places, list) else [places])}
    return pages


@pytest.mark.slow
def test_the_site_is_built_offline_and_its_search_finds_words(tmp_path: Path) -> None:
    for package in ("sphinx", "furo", "myst_parser"):
        pytest.importorskip(package)
    words = [sys.executable, "-m", "sphinx", "-q", "-W", "-b", "html", str(DOCS), str(tmp_path)]
    run = subprocess.run(words, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    index = (tmp_path / "searchindex.js").read_text(encoding="utf-8")
    found = json.loads(index.removeprefix("Search.setIndex(").removesuffix(")"))
    for word, page in (("alembic", "own_files"), ("ponytail", "grooms"), ("stiffness", "drape_a_clip")):
        assert page in pages_with(word, found), word
    commands = (tmp_path / "command_line.html").read_text(encoding="utf-8")
    for option in ("quaffure groom hold", "--settle", "--write-cases"):
        assert option in commands
    pages = {path.name: path.read_text(encoding="utf-8") for path in tmp_path.rglob("*.html")}
    elsewhere = re.compile(r"""<(?:script|link|img)[^>]+(?:src|href)=["']https?://""")
    assert not [name for name, text in pages.items() if elsewhere.search(text)]
    assert "<math" in pages["method.html"]
