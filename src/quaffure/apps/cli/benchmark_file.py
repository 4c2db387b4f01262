"""Output files of `quaffure benchmark`: a .json file, and a plot next to it if matplotlib is installed."""

import importlib.util
from collections.abc import Callable
from pathlib import Path

from quaffure.apps.cli.console import write_json
from quaffure.apps.output_path import check_output


def check_benchmark_output(out: Path) -> None:
    """Refuse the .json file or the plot next to it, before the work.

    Raises:
        InputError: another suffix, no folder to write into, or a folder of one of these names.
    """
    check_output(out, ".json")
    check_output(out.with_suffix(".png"), ".png")


def write_benchmark(out: Path, content: dict[str, object], plot: Callable[[Path], None]) -> str:
    """Write the file and the plot.

    Args:
        plot: writes the picture; imports matplotlib only when it is called.

    Returns:
        A message that names the written files.
    """
    write_json(out, content)
    if importlib.util.find_spec("matplotlib") is None:
        return f"written: {out}; no plot without matplotlib: pip install 'quaffure\\[docs]'"
    picture = out.with_suffix(".png")
    plot(picture)
    return f"written: {out}, {picture}"
