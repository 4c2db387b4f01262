"""`quaffure doctor`: every row, and what it says of a missing package."""

import json
from unittest import mock

import pytest

from quaffure.apps.cli.main import main
from quaffure.extras import EXTRAS


@pytest.mark.slow
def test_it_says_what_is_there_and_how_long_a_drape_takes(capfd: pytest.CaptureFixture[str]) -> None:
    is_there = {"moderngl": False}
    with (
        mock.patch("quaffure.apps.cli.doctor.is_installed", side_effect=lambda name: is_there.get(name, True)),
        mock.patch("quaffure.apps.cli.doctor.DRAPES", 1),
    ):
        main(["doctor", "--json"])
    rows = {row["what"]: row["found"] for row in json.loads(capfd.readouterr().out)}
    assert {"processor", "threads", "bfloat16", "memory", "card"} < rows.keys()
    assert rows["pictures and videos (.png, .mp4)"] == "missing moderngl: pip install 'quaffure[render]'"
    assert sum(found == "installed" for found in rows.values()) == len(EXTRAS) - 1
    for draper in ("network", "strand_newton"):
        assert 1 <= int(rows[f"a drape by {draper}"].split(" ms (2465 strands")[0]) < 60_000
