import pytest

from quaffure.benchmark.paper_table import ratio_rows


def figures(milliseconds: float, inside: float, length: float, orientation: float) -> dict[str, dict[str, float]]:
    return {
        "milliseconds": {"median": milliseconds},
        "body_intersection_percent": {"mean": inside},
        "length_error_percent": {"mean": length},
        "orientation_error_deg": {"mean": orientation},
    }


def test_ratios_are_over_the_network_here_and_in_the_paper() -> None:
    summary = {
        "posed": figures(1, 5, 0, 0),
        "xpbd": figures(1000, 0.1, 0.02, 5),
        "groomgen": figures(8, 0.8, 0.5, 20),
        "neural": figures(4, 0.2, 0.01, 10),
    }
    xpbd, groomgen = ratio_rows(summary)
    assert (xpbd["draper"], groomgen["draper"]) == ("xpbd", "groomgen")
    assert [xpbd[key] for key in ("seconds", "intersection", "length", "orientation")] == [250, 0.5, 2, 0.5]
    # What the paper's text says of its Table 1: 22,000 times as fast as XPBD, 7.5 and 4.5 times as good as GroomGen.
    assert xpbd["seconds, paper"] == pytest.approx(22_119, abs=1)
    assert groomgen["length, paper"] == pytest.approx(7.5, abs=0.05)
    assert groomgen["orientation, paper"] == pytest.approx(4.5, abs=0.05)


def test_there_are_no_ratios_without_the_network_or_over_zero() -> None:
    assert ratio_rows({"xpbd": figures(1, 1, 1, 1)}) == []
    (row,) = ratio_rows({"adam": figures(1, 1, 1, 1), "neural": figures(1, 0, 1, 1)})
    assert row["intersection"] == ""
