"""What `results.json` holds: metrics by case and row, their summary, and all that is needed to read them."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import version
from typing import Any

from quaffure.benchmark.comparison import CaseResult, summarize
from quaffure.benchmark.drape_key import setting_of
from quaffure.benchmark.methods import Method
from quaffure.config import HairMaterial

Results = dict[str, Any]
DIGITS = 6
"""Significant digits that are kept."""


def results_of(
    results: Sequence[CaseResult], rows: Sequence[Method], material: HairMaterial, about: Mapping[str, object]
) -> Results:
    """The whole file, ready for JSON.

    Args:
        about: what the caller adds: the version of the evaluation set, what was skipped, seconds.
    """
    return {
        "version": version("quaffure"),
        **about,
        "material": asdict(material),
        "rows": {
            row.name: {"setting": setting_of(row.draper), "weights": row.notes}
            for row in rows
            if any(row.name in result.metrics for result in results)
        },
        "reference": dict(Counter(name for result in results for name in result.reference).most_common()),
        "machines": sorted({machine for result in results for machine in result.machines}),
        "summary": _rounded(summarize(results)),
        "cases": [_rounded(_renamed(asdict(result))) for result in results],
    }


def _renamed(case: dict[str, Any]) -> dict[str, Any]:
    return {"figures" if name == "metrics" else name: value for name, value in case.items()}


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}")
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    return [_rounded(item) for item in value] if isinstance(value, list | tuple) else value
