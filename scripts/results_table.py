"""The table of results in the README, from docs/evaluation_results.json and docs/clip_jumps.json.

`python scripts/results_table.py` prints it, `--write` puts it between the marks in README.md. A test compares the two.
"""

import json
import statistics
from pathlib import Path
from typing import Any

import tyro

ROOT = Path(__file__).parents[1]
BEGIN, END = "<!-- results: python scripts/results_table.py --write -->\n", "<!-- end of results -->\n"
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
    text = table()
    if write:
        path = ROOT / "README.md"
        path.write_text(with_table(path.read_text(encoding="utf-8"), text), encoding="utf-8")
    print(text)


def table() -> str:
    """Rows of the methods that were evaluated."""
    results = json.loads((ROOT / "docs" / "evaluation_results.json").read_text(encoding="utf-8"))
    jumps = json.loads((ROOT / "docs" / "clip_jumps.json").read_text(encoding="utf-8"))["rows"]
    lines = [COLUMNS, ("---",) * len(COLUMNS)]
    for name, title in ROWS.items():
        if name in results["summary"]["free"]:
            lines.append((title, *_cells(name, results), f"{jumps[name]:.1f}" if name in jumps else ""))
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def with_table(readme: str, text: str) -> str:
    before, _, rest = readme.partition(BEGIN)
    return before + BEGIN + text + END + rest.partition(END)[2]


def _cells(name: str, results: dict[str, Any]) -> tuple[str, ...]:
    summary = results["summary"]["free"][name]
    excess = [
        value
        for case in results["cases"]
        if case["group"] in FREE and name in case["figures"]
        for value in case["figures"][name]["excess_energy"]
    ]
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
