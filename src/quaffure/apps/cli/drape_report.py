"""What `quaffure drape` prints about a drape: faults, metrics with their units, and where the time went."""

import time
from collections.abc import Sized
from typing import Any

from quaffure.apps.cli.console import console, counted, print_json, print_rows
from quaffure.apps.cli.kernel_cache import kernel_seconds
from quaffure.benchmark.drape_checks import MOST_INSIDE_PERCENT, DrapeChecks
from quaffure.benchmark.metrics import UNITS, DrapeMetrics, PerFrame
from quaffure.drape_motion import FRAMES_AT_ONCE
from quaffure.hair.drape_sequence import DrapeSequence
from quaffure.types import Float, Tensor

KERNELS, PREPARATION, DRAPING = "kernels", "preparation", "draping"
"""Steps: compiled code of the solver, made once in an installation; files read and the rest shape found, once in a run;
and what takes longer the more frames there are."""
DEFINITIONS = "docs/metrics.md"
NO_FAULT = f"no tip jumps, and in no frame more than {MOST_INSIDE_PERCENT:g} % of the vertices are inside the body"


class Stopwatch:
    """Adds up the wall time of steps, from the end of the step before. What numba takes to compile kernels, or to read
    them, is no part of the step in which it happens.

    Attributes:
        seconds: by step, `KERNELS` first, then in the order of their first laps.
        compiled: whether a kernel was compiled.
    """

    def __init__(self) -> None:
        self.seconds = {KERNELS: 0.0}
        self.compiled = False
        self._last, self._kernels = time.perf_counter(), kernel_seconds()

    def lap(self, step: str) -> None:
        """Count the time since the last lap as that of this step."""
        now, kernels = time.perf_counter(), kernel_seconds()
        in_kernels = kernels.total - self._kernels.total
        self.seconds[KERNELS] += in_kernels
        self.seconds[step] = self.seconds.get(step, 0.0) + max(now - self._last - in_kernels, 0.0)
        self.compiled |= kernels.compiling > self._kernels.compiling
        self._last, self._kernels = now, kernels

    def text(self, notes: dict[str, str]) -> str:
        """The time of every step.

        Args:
            notes: what is added to steps, in brackets.
        """
        notes = {KERNELS: "compiled; first use of this feature only" if self.compiled else "loaded"} | notes
        steps = [f"{step} {duration(1000 * seconds)}" for step, seconds in self.seconds.items()]
        return ", ".join(
            f"{text} ({notes[step]})" if step in notes else text for step, text in zip(self.seconds, steps)
        )


def report_drape(sequence: DrapeSequence, checks: DrapeChecks, measured: DrapeMetrics | None, times: Stopwatch) -> None:
    """Print the faults of a drape, the time of a drape and of every step, and where they were measured, the table of
    its metrics and of the posed groom's."""
    if measured is not None:
        draped, posed = measured.of_all_frames()
        named = {"posed": posed, str(sequence.meta["draper"]): draped}
        title = f"{sequence.meta['groom']} on {sequence.meta['motion']}, {frames_text(len(sequence))}"
        print_rows([_table_row(key, named, draped[key]) for key in draped], title)
        console.print(f"means over frames unless marked as worst; definitions: {DEFINITIONS}")
    console.print(f"checked: {'; '.join(checks.findings()) or NO_FAULT}")
    console.print(f"time: {times.text({DRAPING: _frame_text(sequence, times)})}")


def _frame_text(sequence: DrapeSequence, times: Stopwatch) -> str:
    """What one frame of a clip took: the mean of a few frames, whose median would hold the preparation of kernels."""
    frames = frames_text(len(sequence))
    if len(sequence) == 1:
        return frames
    if with_preparation(sequence):
        return f"{frames}, {duration(1000 * times.seconds[DRAPING] / len(sequence))} each"
    return f"{frames}, {duration(float(sequence.meta['milliseconds']))} each in the median"


def print_drape_json(
    sequence: DrapeSequence, checks: DrapeChecks, measured: DrapeMetrics | None, times: Stopwatch
) -> None:
    """Print the same as JSON, frame by frame."""
    report: dict[str, Any] = {"faults": checks.findings()}
    report |= {"inside_percent": checks.inside_percent, "jumps": checks.jumping_tips}
    if measured is not None:
        draped, posed = measured.of_all_frames()
        named = {"posed": posed, str(sequence.meta["draper"]): draped}
        rows = {name: {key: values.tolist() for key, values in row.items()} for name, row in named.items()}
        report["per_frame"] = rows
    report |= {"milliseconds": sequence.meta["milliseconds"], "with_preparation": with_preparation(sequence)}
    report |= {"seconds": times.seconds, "meta": sequence.meta}
    print_json(report)


def _table_row(key: str, named: dict[str, PerFrame], draped: Float[Tensor, " frames"]) -> dict[str, object]:
    """Mean and worst frame of a metric for each row, and how often the drape is better than the posed groom."""
    row: dict[str, object] = {"metric": key, "unit": UNITS[key]}
    for name, values in named.items():
        known = values.get(key)
        row[name] = "" if known is None else float(known.mean())
        row[f"{name}, worst frame"] = "" if known is None else float(known.max())
    # Posed hair has no orientation error by definition: no drape has less.
    compared = key in named["posed"] and key != "orientation_error_deg"
    row["frames better"] = f"{int((draped < named['posed'][key]).sum())} of {len(draped)}" if compared else ""
    return row


def with_preparation(sequence: Sized) -> bool:
    """Whether its time includes the preparation of kernels and groom; in long clips only later frames count."""
    return len(sequence) <= FRAMES_AT_ONCE


def duration(milliseconds: float) -> str:
    return f"{milliseconds:.3g} ms" if milliseconds < 1000 else f"{milliseconds / 1000:.3g} s"


def frames_text(count: int) -> str:
    return counted(count, "frame")
