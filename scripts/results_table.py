"""The tables of results in the README, from docs/evaluation_results.json, docs/clip_jumps.json and
docs/solver_results.json.

`python scripts/results_table.py` prints them, `--write` puts each between its marks in README.md. A test compares them.
"""

import json
import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import tyro

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
FREE = ("seen", "unseen")
"""Groups of cases of free hair under its own weight, which every method can drape."""
ROWS = {
    "neural": "network",
    "neural_settled": "network, then three passes of the solver",
    "strand_newton": "our solver, `strand_newton`",
    "paper": "the paper's configuration, trained by us",
    "groomgen": "GroomGen, re-implemented",
    "xpbd": "XPBD",
    "lbfgs": "L-BFGS",
    "adam": "Adam",
    "posed": "no draping",
}
SOLVERS = ("strand_newton", "lbfgs", "adam", "xpbd", "neural", "neural_settled")
"""Rows of the second table, on frames that slow solvers drape in an hour."""
COLUMNS = (
    "method",
    "time a frame",
    "inside [%]",
    "length error [%]",
    "distance [mm]",
    "excess, median",
    "mean",
    "jumps",
)


def main(write: bool = False) -> None:
    for mark, text in tables().items():
        if write:
            path = ROOT / "README.md"
            path.write_text(with_table(path.read_text(encoding="utf-8"), mark, text), encoding="utf-8")
        print(text)


def tables() -> dict[str, str]:
    """Both tables by their marks: the methods on the evaluation set, and the solvers on some frames."""
    results = _read("evaluation_results.json")
    jumps = _read("clip_jumps.json")["rows"]
    free = [case for case in results["cases"] if case["group"] in FREE]
    rows = {
        name: (*_cells(name, results["summary"]["free"][name], free), f"{jumps[name]:.1f}" if name in jumps else "")
        for name in ROWS
        if name in results["summary"]["free"]
    }
    solvers = _read("solver_results.json")
    some = {name: _cells(name, solvers["summary"]["all"][name], solvers["cases"]) for name in SOLVERS}
    return {"results": _table(COLUMNS, rows), "solvers": _table(COLUMNS[:-1], some)}


def with_table(readme: str, mark: str, text: str) -> str:
    begin, end = f"<!-- {mark}: python scripts/results_table.py --write -->\n", f"<!-- end of {mark} -->\n"
    assert begin in readme, begin
    assert end in readme, end
    before, _, rest = readme.partition(begin)
    return before + begin + text + end + rest.partition(end)[2]


def _read(name: str) -> dict[str, Any]:
    return json.loads((DOCS / name).read_text(encoding="utf-8"))


def _table(columns: Sequence[str], rows: dict[str, tuple[str, ...]]) -> str:
    lines = [columns, ("---",) * len(columns), *((ROWS[name], *cells) for name, cells in rows.items())]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def _cells(name: str, summary: dict[str, Any], cases: list[dict[str, Any]]) -> tuple[str, ...]:
    excess = [value for case in cases if name in case["figures"] for value in case["figures"][name]["excess_energy"]]
    mean = {key: summary[key].get("mean", 0.0) for key in summary}
    return (
        _time(summary["milliseconds"]["median"]),
        _short(mean["body_intersection_percent"]),
        f"{mean['length_error_percent']:.1g}",
        f"{mean['distance_mm']:.0f}",
        _short(statistics.median(excess)),
        _short(mean["excess_energy"]),
    )


def _short(value: float) -> str:
    return f"{value:.0f}" if abs(value) >= 10 else f"{value:.2g}"


def _time(milliseconds: float) -> str:
    return f"{milliseconds:.0f} ms" if milliseconds < 1000 else f"{milliseconds / 1000:.1f} s"


if __name__ == "__main__":
    tyro.cli(main)
