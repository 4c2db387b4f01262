"""What every `quaffure benchmark` leaves: a .json file, and a plot beside it where matplotlib is installed."""

import importlib.util
import json
from collections.abc import Callable
from pathlib import Path

from quaffure.apps.cli.outputs import check_out
from quaffure.io.atomic import replacing


def check_benchmark_out(out: Path) -> None:
    """Refuse the .json file or the plot beside it before the work.

    Raises:
        InputError: another suffix, no folder to write into, or a folder of one of these names.
    """
    check_out(out, ".json")
    check_out(out.with_suffix(".png"), ".png")


def write_benchmark(out: Path, written: dict[str, object], plot: Callable[[Path], None]) -> str:
    """Write the file and the plot; returns what to say of it.

    Args:
        plot: writes the picture; imports matplotlib only when it is called.
    """
    with replacing(out) as beside:
        beside.write_text(json.dumps(written, indent=1) + "\n", encoding="utf-8")
    if importlib.util.find_spec("matplotlib") is None:
        return f"written: {out}; no plot without matplotlib: pip install 'quaffure\\[docs]'"
    picture = out.with_suffix(".png")
    plot(picture)
    return f"written: {out}, {picture}"
