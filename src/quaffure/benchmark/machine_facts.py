"""The machine that times are measured on, as benchmark files name it."""

import os
import platform
import re
from pathlib import Path

import torch
from numba import get_num_threads

CPU_INFO = Path("/proc/cpuinfo")


def machine_facts() -> dict[str, object]:
    """Processor, torch and threads, as the `machine` of a `bench.json`."""
    return {
        "processor": platform.processor() or platform.machine(),
        "processors": os.cpu_count(),
        "torch": torch.__version__,
        "torch_threads": torch.get_num_threads(),
        "numba_threads": get_num_threads(),
    }


def machine() -> str:
    """The same in one line, as the evaluation's results have it."""
    threads = f"torch {torch.get_num_threads()}, numba {get_num_threads()} threads"
    clock = ", processor time" if times_the_processor() else ""
    return f"{processor()}, {os.cpu_count()} processors, {threads}{clock}"


def times_the_processor() -> bool:
    """Whether drapes are timed by processor time. Where torch and numba compute on one thread, and no card is waited
    for, it is wall time without the waits that other programs cause."""
    return torch.get_num_threads() == get_num_threads() == 1 and not torch.cuda.is_available()


def processor() -> str:
    """Name of the processor."""
    # Python names it on few systems; Linux has it here.
    named = re.search(r"model name\s*: (.+)", CPU_INFO.read_text()) if CPU_INFO.is_file() else None
    return named[1] if named else platform.processor() or platform.machine()
