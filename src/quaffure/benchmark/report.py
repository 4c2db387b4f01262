"""The page of an evaluation, in Markdown: nothing on it that `results.json` does not hold."""

import json
from pathlib import Path
from typing import Any

from quaffure.benchmark.comparison import TIME
from quaffure.benchmark.paper_table import ratio_rows
from quaffure.benchmark.results import Results
from quaffure.extras import is_installed
from quaffure.io.atomic import replacing
from quaffure.io.output_path import made_folder

PAGE = "evaluation_results.md"
PICTURE = "figures/evaluation_results.png"
METRICS = (
    "body_intersection_percent", "length_error_percent", "length_error_percent_max", "orientation_error_deg",
    "density_excess_percent", "off_vertical_deg", "in_the_air_percent", "energy", "excess_energy", "distance_mm",
    "jitter", TIME,
)  # fmt: skip
"""Metrics in the order of the columns; docs/metrics.md explains them."""
RATIOS = "Table 1 of the paper: over the network"
BY_GROUP = ("body_intersection_percent", "excess_energy", "distance_mm")


def write_report(folder: Path, results: Results) -> list[Path]:
    """Write the page, and its picture where matplotlib is installed.

    Returns:
        The files written.

    Raises:
        InputError: the folder cannot be made or written to.
    """
    picture = folder / PICTURE
    made_folder(picture.parent, "a folder for the report")
    drawn = []
    if is_installed("matplotlib"):
        from quaffure.benchmark.plots import plot_results

        plot_results(picture, results)
        drawn = [picture]
    # As the file of results has them, from which the page can be made again: JSON knows no tuples.
    results = json.loads(json.dumps(results))
    with replacing(folder / PAGE) as temporary:
        temporary.write_text(page(results, with_picture=bool(drawn)), encoding="utf-8")
    return [folder / PAGE, *drawn]


def page(results: Results, with_picture: bool) -> str:
    """The page's text."""
    summary = results["summary"]
    of_all, hair = headline(summary)
    parts = ["# Results of the evaluation", _about(results)]
    if with_picture:
        parts.append(f"![Quality against time, one mark a draper]({PICTURE})")
    parts += [f"## Means{hair}", _table(mean_rows(of_all)), f"## Worst frames{hair}", _table(worst_rows(of_all))]
    ratios = ratio_rows(of_all)
    if ratios:
        parts += [f"## {RATIOS}", _table(ratios)]
    for metric in BY_GROUP:
        rows = group_rows(summary, metric)
        if rows:
            parts += [f"## {metric} by group of cases", _table(rows)]
    parts += ["## Rows", _table(setting_rows(results))]
    return "\n\n".join(parts) + "\n"


def headline(summary: Results) -> tuple[Results, str]:
    """What the first tables show, and how their titles say it: free hair, whose cases other rows can drape as well,
    where the set has tied hair or other loadings too."""
    others = summary.keys() - {"all", "free", "seen", "unseen", "own"}
    if "free" in summary and any(not group.startswith("clip ") for group in others):
        return summary["free"], ", free hair"
    return summary["all"], ""


def mean_rows(of_group: dict[str, dict[str, dict[str, float]]]) -> list[dict[str, object]]:
    """A table row a draper: means over cases, the median of times."""
    middle = {key: "median" if key == TIME else "mean" for key in METRICS}
    return [{"draper": row} | _cells(values, middle) for row, values in of_group.items()]


def worst_rows(of_group: dict[str, dict[str, dict[str, float]]]) -> list[dict[str, object]]:
    """A table row a draper: the worst frames."""
    return [{"draper": row} | _cells(values, dict.fromkeys(METRICS, "worst")) for row, values in of_group.items()]


def group_rows(summary: Results, metric: str) -> list[dict[str, object]]:
    """A table row a draper: means of one metric in every group; none where no draper has the metric."""
    of_all, _ = headline(summary)
    known = [row for row in of_all if metric in of_all[row]]
    return [
        {"draper": row} | {group: rows.get(row, {}).get(metric, {}).get("mean", "") for group, rows in summary.items()}
        for row in known
    ]


def setting_rows(results: Results) -> list[dict[str, object]]:
    return [
        {"draper": name, "setting": _in_words(row["setting"]), "weights": _in_words(row["weights"])}
        for name, row in results["rows"].items()
    ]


def cell_text(cell: object) -> str:
    """A cell as all tables have it."""
    return f"{cell:.4g}" if isinstance(cell, float) else str(cell)


def _cells(values: dict[str, dict[str, float]], kinds: dict[str, str]) -> dict[str, object]:
    return {key: values[key][kind] if key in values else "" for key, kind in kinds.items()}


def _table(rows: list[dict[str, object]]) -> str:
    lines = [list(rows[0]), ["---"] * len(rows[0]), *([cell_text(cell) for cell in row.values()] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _about(results: Results) -> str:
    frames = sum(len(case["frames"]) for case in results["cases"])
    of_set = results["evaluation_set"]
    cases = "Cases of the user" if of_set is None else f"Evaluation set, version {of_set}"
    about = [
        f"Made by `quaffure evaluate` {results['version']}; do not edit. How to read it is said in quaffure's "
        "docs/evaluation.md, what the columns mean in its docs/metrics.md.",
        f"- {cases}{', quick' if results['quick'] else ''}: {len(results['cases'])}, frames: {frames}"
        f"{_skipped(results['skipped'])}",
        f"- Hair: {_in_words(results['material'])}",
        f"- Reference, frames each solver is it: {_in_words(results['reference']) or 'none'}",
        f"- Times on: {'; '.join(results['machines'])}",
    ]
    return about[0] + "\n\n" + "\n".join(about[1:])


def _skipped(skipped: dict[str, str]) -> str:
    if not skipped:
        return ""
    return f"; left out, as their files were not there: {', '.join(skipped)}"


def _in_words(values: dict[str, Any]) -> str:
    parts = []
    for name, value in values.items():
        text = f"({_in_words(value)})" if isinstance(value, dict) else cell_text(value)
        parts.append(text if name == "class" else f"{name} {text}")
    return ", ".join(parts)
