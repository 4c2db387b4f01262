"""Several processes on one run, as a launcher such as torchrun starts them, or one by itself.

Each draws poses of its own. Gradients are averaged, so all take the same step and hold the same weights.
"""

import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import timedelta
from typing import Literal, TypeVar

import numba
import torch
from torch import distributed, nn

from quaffure.errors import InputError

Device = Literal["auto", "cpu", "cuda"]
T = TypeVar("T")

# The others wait while the first process validates.
_TIMEOUT = timedelta(hours=1)
_LAUNCHER_VARIABLES = ("RANK", "LOCAL_RANK", "MASTER_ADDR", "MASTER_PORT")


@dataclass(frozen=True)
class Worker:
    """One of the processes of a run.

    Attributes:
        rank: from 0; the first one validates, saves and reports.
        world_size: how many there are.
        device: that this one computes on.
    """

    rank: int = 0
    world_size: int = 1
    device: torch.device = field(default_factory=lambda: torch.device("cpu"))

    @property
    def is_first(self) -> bool:
        return self.rank == 0

    def average_gradients(self, network: nn.Module) -> None:
        """Replace every gradient by its mean over all workers, in one exchange.

        Not `DistributedDataParallel`: a step goes backwards once for every groom, and only the sum is exchanged.
        """
        if self.world_size == 1:
            return
        gradients = [parameter.grad for parameter in network.parameters() if parameter.grad is not None]
        flat = torch.cat([gradient.flatten() for gradient in gradients])
        distributed.all_reduce(flat)
        parts = (flat / self.world_size).split([gradient.numel() for gradient in gradients])
        for gradient, mean in zip(gradients, parts):
            gradient.copy_(mean.view_as(gradient))

    def any(self, is_so: bool) -> bool:
        """Whether it is so in any of the workers; all of them have to ask."""
        if self.world_size == 1:
            return is_so
        found = torch.tensor(int(is_so), device=self.device)
        distributed.all_reduce(found, distributed.ReduceOp.MAX)
        return bool(found)

    def broadcast_from_first(self, make: Callable[[], T]) -> T:
        """A value that the first worker makes, sent to all of them: no other one needs access to its disk."""
        if self.world_size == 1:
            return make()
        made = [make() if self.is_first else None]
        distributed.broadcast_object_list(made, device=self.device)
        return made[0]  # type: ignore[return-value]


SINGLE_PROCESS = Worker()


@contextmanager
def joined_workers(device: Device = "auto") -> Iterator[Worker]:
    """This process among those that a launcher started; `SINGLE_PROCESS` on a device where none did.

    Args:
        device: `auto` is CUDA where there is a device, each process of a machine on one of its own.

    Raises:
        InputError: no CUDA device, or an environment with WORLD_SIZE in which the launcher's other variables are
            missing, or are no numbers that fit.
    """
    kind = _kind(device)
    world_size = _whole_number("WORLD_SIZE", range(1, 2**16)) if "WORLD_SIZE" in os.environ else 1
    if world_size == 1:
        yield Worker(device=torch.device(kind))
        return
    missing = [name for name in _LAUNCHER_VARIABLES if name not in os.environ]
    if missing:
        raise InputError("environment", "all variables that torchrun sets with WORLD_SIZE", f"no {missing}")
    _whole_number("MASTER_PORT", range(1, 2**16))
    worker = Worker(_whole_number("RANK", range(world_size)), world_size, _local_device(kind))
    distributed.init_process_group("nccl" if kind == "cuda" else "gloo", timeout=_TIMEOUT)
    try:
        yield worker
        # Gloo aborts a process that leaves while another one still talks to it.
        distributed.barrier()
    finally:
        distributed.destroy_process_group()


def _whole_number(variable: str, allowed: range) -> int:
    text = os.environ[variable]
    if not re.fullmatch(r"\d{1,5}", text) or int(text) not in allowed:
        expected = f"a whole number from {allowed.start} to {allowed.stop - 1}"
        raise InputError(f"environment variable {variable}", expected, f"{text[:40]!r}")
    return int(text)


def _kind(device: Device) -> str:
    found = torch.cuda.is_available()
    if device == "cuda" and not found:
        raise InputError("--device cuda", "a CUDA device and a torch built for it", "none")
    return "cuda" if device != "cpu" and found else "cpu"


def _local_device(kind: str) -> torch.device:
    if kind == "cpu":
        # A launcher shares out the cores by OMP_NUM_THREADS, which torch reads and numba does not.
        numba.set_num_threads(min(numba.get_num_threads(), torch.get_num_threads()))
        return torch.device("cpu")
    own = torch.device("cuda", _whole_number("LOCAL_RANK", range(torch.cuda.device_count())))
    torch.cuda.set_device(own)
    return own
