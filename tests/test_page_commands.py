"""Every command on a how-to page runs as it stands there, page by page, in one folder; slow ones with the slow tests.

What makes that cheap is around the commands and not in them: bundled grooms have about 60 strands, bundled clips take a
second, pictures are small, few strands are interpolated, and a table is draped in this process. The files of the reader
that pages name are written before (`write_inputs`).
"""

from collections.abc import Iterator
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path

import pytest

from quaffure import load_motion
from quaffure.apps import character_table
from quaffure.apps.cli.main import main, parse
from quaffure.apps.row_workers import Outcome
from quaffure.body import CLIP_NAMES
from quaffure.procedural import STYLES
from tests.page_commands import PROGRAMS, commands, write_inputs

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
HOW_TO = [ROOT / "README.md", *(DOCS / f"{page}.md" for page in (
    "quick_start", "drape_a_clip", "grooms", "export", "guides", "view", "crowd", "train", "benchmark", "extend",
    "metrics", "inference", "evaluation",
)), *sorted(DOCS.glob("own_*.md"))]  # fmt: skip
ROOT_ROWS = 10
STRANDS_BETWEEN = 100
FRAMES_OF_CLIPS = 31
"""Of the bundled clips: up to the last frame that a page names."""
every_page = pytest.mark.parametrize("page", HOW_TO, ids=lambda path: path.stem)


class ThisProcess:
    """In place of the processes that drape a table, where grooms are not small."""

    in_flight = 1

    def __init__(self, count: int) -> None:
        self.count = count

    def submit(self, row: character_table.CharacterRow, draper: str) -> "Future[Outcome]":
        character_table.drape_row(row, draper)
        done = Future[Outcome]()
        done.set_result(Outcome())
        return done

    def close(self) -> None:
        pass


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, small_pictures: None) -> Iterator[Path]:
    """An empty working folder where grooms, pictures and interpolated hair are small."""
    small = {name: replace(style, root_rows=ROOT_ROWS) for name, style in STYLES.items()}
    for module in ("procedural.generator", "apps.cli.groom"):
        monkeypatch.setattr(f"quaffure.{module}.STYLES", small)
    from quaffure.hair import interpolation_of

    def shorter(source, *more):
        motion = load_motion(source, *more)
        return motion.frames(f":{FRAMES_OF_CLIPS}") if source in CLIP_NAMES else motion

    monkeypatch.setattr("quaffure.apps.cli.inputs.load_motion", shorter)
    monkeypatch.setattr("quaffure.apps.cli.characters.LocalProcesses", ThisProcess)

    def fewer(groom, body, count, *rest, **more):
        return interpolation_of(groom, body, min(count, STRANDS_BETWEEN), *rest, **more)

    monkeypatch.setattr("quaffure.apps.cli.shown_strands.interpolation_of", fewer)
    monkeypatch.setattr("quaffure.apps.render.contact_sheet.SHOWN_STRANDS", STRANDS_BETWEEN)
    for name in ("SHOWN_STRANDS", "SHOWN_IN_VIDEOS"):
        monkeypatch.setattr(f"quaffure.hair.guide_interpolation.{name}", STRANDS_BETWEEN)
    monkeypatch.setattr("quaffure.apps.render.contact_sheet.SUPERSAMPLING", 1)
    monkeypatch.chdir(tmp_path)
    character_table._groom.cache_clear()
    yield tmp_path
    character_table._groom.cache_clear()


def run_page(path: Path, folder: Path, slow_too: bool) -> int:
    """Run the commands of a page in their order; the number of them."""
    page = path.read_text(encoding="utf-8")
    chosen = [command for command in commands(page) if command.runs and (slow_too or not command.is_slow)]
    if chosen:
        write_inputs(folder, page)
    for command in chosen:
        failure = failure_of(command.arguments)
        assert not failure, f"{path.name}: {command.line}: {failure}"
    return len(chosen)


def is_slow(path: Path) -> bool:
    """Whether commands of a page run with the slow tests alone."""
    return any(command.runs and command.is_slow for command in commands(path.read_text(encoding="utf-8")))


def failure_of(arguments: list[str]) -> str:
    """Why a command ended with another exit code than 0; empty where it did not."""
    try:
        main(arguments)
    except SystemExit as stop:
        return f"exit code {stop.code}" if stop.code else ""
    return ""


@every_page
def test_the_commands_of_a_page_exist(page: Path) -> None:
    for command in commands(page.read_text(encoding="utf-8")):
        words = command.words
        assert words[0] in PROGRAMS, command.line
        if words[0] == "quaffure":
            parse(words[1:])
        if words[0] == "python" and words[1].endswith(".py"):
            assert (ROOT / words[1]).is_file(), command.line


@every_page
def test_the_commands_of_a_page_run(page: Path, folder: Path, request: pytest.FixtureRequest) -> None:
    if f"{SLOW_TEST}[{page.stem}]" in {item.name for item in request.session.items}:
        pytest.skip("they run with the slow ones of the page")
    if not run_page(page, folder, slow_too=False):
        pytest.skip("slow ones alone")


@pytest.mark.slow
@pytest.mark.parametrize("page", [path for path in HOW_TO if is_slow(path)], ids=lambda path: path.stem)
def test_the_slow_commands_of_a_page_run(page: Path, folder: Path) -> None:
    """With the others of the page, whose files they read."""
    assert run_page(page, folder, slow_too=True)


SLOW_TEST = test_the_slow_commands_of_a_page_run.__name__


def test_blocks_their_kinds_and_continued_lines_are_found() -> None:
    page = """
Text with `quaffure info`.

    quaffure a --x \\
        1  # why

    groom,motion
    bob,nod

<!-- test: slow -->
```bash
$ quaffure b
```

```python
quaffure = 1
```

<!-- test: skip, serves until Ctrl-C -->
```console
quaffure c
```

<!-- test: slow, with --steps 2 --every 1 -->

    quaffure d --steps 400
"""
    found = list(commands(page))
    assert [(command.words, command.kind) for command in found] == [
        (["quaffure", "a", "--x", "1"], ""),
        (["quaffure", "b"], "slow"),
        (["quaffure", "c"], "skip, serves until Ctrl-C"),
        (["quaffure", "d", "--steps", "400"], "slow, with --steps 2 --every 1"),
    ]
    assert [command.runs for command in found] == [True, True, False, True]
    assert [command.is_slow for command in found] == [False, True, False, True]
    assert found[-1].arguments == ["d", "--steps", "2"]


def test_a_command_that_fails_is_named(tmp_path: Path, folder: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("    quaffure groom hold bob --out wrong.npz\n", encoding="utf-8")
    with pytest.raises(AssertionError, match="groom hold bob"):
        run_page(page, folder, slow_too=False)
