"""Words that are no command: one plain line, which ends with the command whose help to read, and exit code 2."""

import pytest

from quaffure.apps.cli.drape import DrapeCommand
from quaffure.apps.cli.main import main, parse


def refused(capfd: pytest.CaptureFixture[str], words: str) -> str:
    with pytest.raises(SystemExit) as stop:
        main(words.split())
    said = capfd.readouterr()
    assert stop.value.code == 2
    assert not said.out
    assert said.err.count("\n") == 1
    assert not set("╭│─╰") & set(said.err)
    return said.err


@pytest.mark.parametrize(
    ("words", "reason", "command"),
    [
        ("drape bob --colour red", "unknown option --colour", "drape"),
        ("drape bob --drapr neural --out a.npz", "unknown option --drapr, did you mean --draper?", "drape"),
        ("drape bob more --out a.npz", "unexpected more", "drape"),
        ("drape bob --motion", "--motion: expected a value, found none", "drape"),
        ("drape --wrong bob --out a.npz", "unknown option --wrong", "drape"),
        ("drape bob --settle few --out a.npz", "--settle: expected a whole number, found 'few'", "drape"),
        ("drape bob --stiffness soft --out a.npz", "--stiffness: expected a number, found 'soft'", "drape"),
        ("drape bob --points many --out a.npz", "--points: expected a whole number, found 'many'", "drape"),
        ("drape bob --points 0 --out a.npz", "--points: expected 2 to 255 vertices of a strand, found 0", "drape"),
        ("drape bob --rest soft --out a.npz", "--rest: expected one of design, stress-free, found 'soft'", "drape"),
        ("drape", "missing GROOM: A bundled groom", "drape"),
        ("groom import --uot a.npz", "missing --out PATH: Where to write (.npz); unknown option --uot", "groom import"),
        ("groom comb", "expected a command, one of new, import, hold, found 'comb'", "groom"),
        ("benchmark", "expected a command, one of solvers, inference, found none", "benchmark"),
        ("body show", "missing BODY: A body (.npz); --picture PATH Where to draw it (.png)", "body show"),
        ("comb bob", "found 'comb'", ""),
        ("--verbose", "unknown option --verbose", ""),
    ],
)
def test_words_that_are_no_command(capfd: pytest.CaptureFixture[str], words: str, reason: str, command: str) -> None:
    line = refused(capfd, words)
    assert line.startswith("quaffure: ")
    assert reason in line
    assert line.endswith(f"; see: {f'quaffure {command}'.strip()} --help\n")


def test_the_version_is_printed(capfd: pytest.CaptureFixture[str]) -> None:
    from quaffure import __version__

    with pytest.raises(SystemExit) as stop:
        main(["--version"])
    assert not stop.value.code
    assert capfd.readouterr().out == f"quaffure {__version__}\n"
    with pytest.raises(SystemExit):
        main(["--help"])
    assert "quaffure --version" in " ".join(capfd.readouterr().out.split())


@pytest.mark.parametrize(
    ("words", "settle", "coherent"),
    [
        ("", 0, True),
        ("--coherent", 0, True),
        ("--no-coherent", 0, False),
        ("--settle 5", 5, True),
        ("--settle", 3, True),
        ("--settle --no-coherent", 3, False),
    ],
)
def test_what_may_be_left_out(words: str, settle: int, coherent: bool) -> None:
    command = parse(f"drape bob --out a.npz {words}".split())
    assert isinstance(command, DrapeCommand)
    assert (command.settle, command.coherent) == (settle, coherent)
