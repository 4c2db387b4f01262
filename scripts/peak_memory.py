"""Time and peak memory of a command with all of its processes (Linux): `peak_memory.py quaffure drape ...`.

Memory is the proportional set size: pages of files that are mapped count, too, and shared pages once.
"""

import subprocess
import sys
import time
from pathlib import Path

INTERVAL = 0.1
"""Between two samples [s]."""
FIELDS = ("Pss", "Pss_Anon", "Pss_File")


def main(command: list[str]) -> int:
    """Run a command and print what it took. Returns its exit code."""
    if not command:
        print(__doc__)
        return 2
    start, peak = time.monotonic(), dict.fromkeys(FIELDS, 0)
    with subprocess.Popen(command) as process:
        while process.poll() is None:
            found = [_memory(one) for one in _family(process.pid)]
            now = {field: sum(memory.get(field, 0) for memory in found) for field in FIELDS}
            peak = {field: max(peak[field], now[field]) for field in FIELDS}
            time.sleep(INTERVAL)
    whole, own, files = (peak[field] / 1e6 for field in FIELDS)
    memory = f"at most {whole:.2f} GB: {own:.2f} GB of its own, {files:.2f} GB pages of files"
    print(f"{time.monotonic() - start:.1f} s; {memory}")
    return process.returncode


def _family(parent: int) -> list[int]:
    """A process and all that it and its own started."""
    found = [parent]
    for one in found:
        for thread in Path(f"/proc/{one}/task").glob("*/children"):
            try:
                found += map(int, thread.read_text().split())
            except OSError:  # it has ended
                continue
    return found


def _memory(process: int) -> dict[str, int]:
    """Sizes of a process [kB]; none of one that has ended."""
    try:
        lines = Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()[1:]
    except OSError:
        return {}
    return {name: int(size.split()[0]) for name, size in (line.split(":") for line in lines) if name in FIELDS}


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
