"""Table 1 of the paper: what it measured, and the same ratios from an evaluation.

Absolute values cannot be compared: grooms, body, poses and machine are others, and the paper gives its length and
orientation columns without formula or unit. What each method has over the paper's own network can.
"""

from quaffure.benchmark.comparison import TIME

Summary = dict[str, dict[str, dict[str, float]]]
NETWORK = "neural"

COLUMNS = {
    "seconds": (TIME, "median"),
    "intersection": ("body_intersection_percent", "mean"),
    "length": ("length_error_percent", "mean"),
    "orientation": ("orientation_error_deg", "mean"),
}
"""The metric that stands for each column, and how it is summed up."""
PAPER = {
    "adam": (179.38, 0.22, 103.53, 76.15),
    "lbfgs": (281.18, 0.22, 89.53, 70.22),
    "xpbd": (63.26, 0.01, 57.96, 18.10),
    "groomgen": (0.00249, 0.39, 1319.74, 1281.96),
    NETWORK: (0.00286, 0.26, 175.42, 286.13),
}
"""Sec. 4.2, by the names of our rows, in the order of `COLUMNS`: seconds for one drape, body intersection [%], and
length and orientation, whose units are not given."""


def ratio_rows(summary: Summary) -> list[dict[str, object]]:
    """A table row a method: each column over the network's, here and in the paper; none without the network.

    Args:
        summary: metrics of all cases by row, `results.json`'s `summary["all"]`.
    """
    if NETWORK not in summary:
        return []
    rows: list[dict[str, object]] = []
    for name in (name for name in summary if name in PAPER and name != NETWORK):
        row: dict[str, object] = {"draper": name}
        for (column, (metric, kind)), printed, network in zip(COLUMNS.items(), PAPER[name], PAPER[NETWORK]):
            own, ours = (summary[each].get(metric, {}).get(kind) for each in (name, NETWORK))
            row[column] = own / ours if own is not None and ours else ""
            row[f"{column}, paper"] = printed / network
        rows.append(row)
    return rows
