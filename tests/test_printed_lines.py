"""What is printed: names as they are, and no end of the work where nothing takes the lines."""

import errno
import os
import subprocess
import sys
from io import StringIO
from pathlib import Path

import pytest

from quaffure import InputError
from quaffure.apps.cli import console as printing
from quaffure.apps.cli.console import PlainConsole, print_json, print_rows
from tests.training_runs import QUAFFURE

NAMES = ("[/x]", "take[final].npz", "[bold]", ":smile:", "a" * 300)


class Full(StringIO):
    """A file on a full disk."""

    def write(self, text: str) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize("name", NAMES)
def test_names_are_printed_as_they_are(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    printing.console.print(f"written: {name}")
    assert capsys.readouterr().out == f"written: {name}\n"
    if len(name) < 100:
        print_rows([{"groom": name}], title=name)
        title, *table = capsys.readouterr().out.splitlines()
        assert title.strip() == name
        assert any(name in line for line in table)


def test_work_goes_on_where_nothing_takes_the_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", Full())
    to = PlainConsole()
    for _ in range(2):
        to.print("a line")
    assert to.lost == "No space left on device"
    with pytest.raises(InputError, match=r"standard output: .*found No space left on device"):
        print_json({})


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device of Linux")
@pytest.mark.parametrize("options", [pytest.param([], marks=pytest.mark.slow), ["--json"]])
def test_a_full_disk_under_the_output_is_told_in_one_line(options: list[str]) -> None:
    with open("/dev/full", "w") as full:
        run = subprocess.run([QUAFFURE, "info", *options], stdout=full, stderr=subprocess.PIPE, text=True)
    assert run.returncode == 2
    assert run.stderr.startswith("quaffure: standard output: expected ")
    assert run.stderr.count("\n") == 1


def test_a_closed_output_is_no_error() -> None:
    command = f"{QUAFFURE} info >&-; echo $? >&2; {QUAFFURE} info | head -c 1 >/dev/null; echo ${{PIPESTATUS[0]}} >&2"
    run = subprocess.run(["bash", "-c", command], stderr=subprocess.PIPE, text=True)
    assert run.stderr == "0\n0\n"
