"""Files read as they are asked for, each within a limit of processor time.

Each line of the standard input holds the name of a reader, paths, and the limit for each [s], 0 for none. Each line of
the output is JSON with the outcome of a file: `read`, `refused` for an `InputError`, `raised` for another error,
`not finite` where NaN or infinity was read, or `too long` or `ended` where the file ended the process that read it. It
is a child of this one: another takes no time to start.
"""

import gc
import json
import os
import signal
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

from quaffure import InputError
from tests.fuzzing.finiteness import not_finite


def outcome_of(read: Callable[[Path], object], path: Path) -> dict[str, Any]:
    """What became of a file."""
    start = time.process_time()
    said = ""
    try:
        place = not_finite(read(path))
        outcome, said = ("not finite", f"NaN or infinity in {place}") if place else ("read", "")
    except InputError as error:
        outcome, said = "refused", str(error)
        if "\n" in said:
            outcome = "raised"
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        outcome, said = "raised", f"{type(error).__name__}: {error} ({Path(place.filename).name}:{place.lineno})"
    return {"outcome": outcome, "said": said, "seconds": time.process_time() - start}


def serve(known: dict[str, Callable[[Path], object]]) -> None:
    """Read files to the end of the input, by a child, and by another where one has ended."""
    gc.freeze()  # of all that is loaded a child would otherwise make a copy
    print("ready", flush=True)
    while True:
        child = os.fork()
        if not child:
            _answer(known)
            os._exit(0)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        if code == 0:
            return
        outcome = "too long" if code == -signal.SIGPROF else "ended"
        print(json.dumps({"outcome": outcome, "said": f"the process ended with {code}", "seconds": 0.0}), flush=True)


def _answer(known: dict[str, Callable[[Path], object]]) -> None:
    while line := sys.stdin.readline():
        name, paths, seconds = json.loads(line)
        for path in paths:
            # The signal of this timer ends the process in the midst of a library, too.
            signal.setitimer(signal.ITIMER_PROF, seconds)
            found = outcome_of(known[name], Path(path))
            signal.setitimer(signal.ITIMER_PROF, 0)
            print(json.dumps(found), flush=True)
