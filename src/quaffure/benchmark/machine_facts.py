"""What a benchmark file says of the machine that it was made on."""

import os
import platform

import torch
from numba import get_num_threads


def machine_facts() -> dict[str, object]:
    """Processor, torch and threads, as the `machine` of a `bench.json`."""
    return {
        "processor": platform.processor() or platform.machine(),
        "processors": os.cpu_count(),
        "torch": torch.__version__,
        "torch_threads": torch.get_num_threads(),
        "numba_threads": get_num_threads(),
    }
