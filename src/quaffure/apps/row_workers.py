"""Rows of a table of characters draped by many processes: of this machine, or of a Ray cluster.

A row is finished when its output is there: files appear whole or not at all, so a run that was killed continues with
the rows that are left.
"""

import multiprocessing
import socket
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from importlib.metadata import version
from itertools import islice
from typing import Any, NamedTuple, Protocol, runtime_checkable

import torch
from numba import set_num_threads

from quaffure.apps.character_table import CharacterRow, drape_row
from quaffure.errors import InputError, refused
from quaffure.extras import require_extra

CONNECTION_SECONDS = 10.0
LONGEST_REASON = 200
"""Characters of what is said about a process that has ended."""


class Outcome(NamedTuple):
    """What became of one try of a row.

    Attributes:
        error: empty without one.
        is_final: whether another try would end alike.
        has_ended: whether its process has.
    """

    error: str = ""
    is_final: bool = False
    has_ended: bool = False


@runtime_checkable
class RowWorkers(Protocol):
    """Processes that drape rows.

    Attributes:
        in_flight: rows given to them at once, those that wait included.
    """

    in_flight: int

    def submit(self, row: CharacterRow, draper: str) -> "Future[Outcome]": ...
    def close(self) -> None: ...


class LocalProcesses:
    """Processes of this machine. Where one ends, so do all others, and new ones are started.

    Args:
        count: how many.
    """

    def __init__(self, count: int) -> None:
        self._count, self.in_flight = count, 2 * count
        self._pool = self._started()

    def submit(self, row: CharacterRow, draper: str) -> "Future[Outcome]":
        try:
            return self._pool.submit(try_row, row, draper)
        except BrokenProcessPool:
            self._pool.shutdown()
            self._pool = self._started()
            return self._pool.submit(try_row, row, draper)

    def close(self) -> None:
        self._pool.shutdown(cancel_futures=True)

    def _started(self) -> ProcessPoolExecutor:
        # Forked children of a process with threads may hang.
        return ProcessPoolExecutor(self._count, multiprocessing.get_context("spawn"))


class RayCluster:
    """An existing Ray cluster, on whose machines quaffure is installed and files have the same paths.

    Args:
        address: `auto`, `HOST:PORT`, or `ray://HOST:PORT`.
        count: rows in flight; twice the cluster's processors without it.

    Raises:
        InputError: Ray is not installed, no cluster has this address, or quaffure is missing there or of another
            version.
    """

    def __init__(self, address: str, count: int = 0) -> None:
        require_extra("ray", "--ray")
        import ray

        with refused("--ray", "the address of a running Ray cluster", Exception):
            _check_reachable(address)
            ray.init(address=address, log_to_driver=False, logging_level="ERROR")
        self.processors = max(int(ray.cluster_resources().get("CPU", 0)), 1)
        self.in_flight = count or 2 * self.processors
        # Tries are counted here, as for local processes.
        options: dict[str, Any] = {"num_cpus": 1, "max_retries": 0}
        try:
            found = ray.get(ray.remote(**options)(version).remote("quaffure"))
        except Exception as error:
            found = _last_line(error)
        if found != version("quaffure"):
            ray.shutdown()
            raise InputError("--ray", f"quaffure {version('quaffure')} on the cluster's machines", found)
        self._try_row = ray.remote(**options)(try_row)

    def submit(self, row: CharacterRow, draper: str) -> "Future[Outcome]":
        future: Future[Outcome] = self._try_row.remote(row.absolute(), draper).future()
        return future

    def close(self) -> None:
        import ray

        ray.shutdown()


@dataclass(frozen=True)
class Finished:
    """What became of a row: without an error, its output is there."""

    row: CharacterRow
    error: str = ""


def drape_rows(rows: Sequence[CharacterRow], draper: str, workers: RowWorkers, retries: int = 1) -> Iterator[Finished]:
    """Drape the rows, each as soon as a process is free; yields each when it is finished or has failed for good.

    A row that its input makes impossible fails at once; any other error, and a process that ended, is tried again. Rows
    whose process ended are tried again one by one, so that none ends that of another.

    Args:
        draper: one of `quaffure.apps.character_table.CLIP_DRAPERS`.
        retries: how often a row is tried again.
    """
    left: Sequence[CharacterRow] = rows
    alone: Sequence[CharacterRow] = ()
    for attempt in range(retries + 1):
        again: list[CharacterRow] = []
        ended: list[CharacterRow] = []
        for part, in_flight in ((left, workers.in_flight), (alone, 1)):
            for row, outcome in _tried(part, draper, workers, in_flight):
                if not outcome.error or outcome.is_final or attempt == retries:
                    yield Finished(row, outcome.error)
                else:
                    (ended if outcome.has_ended else again).append(row)
        left, alone = again, ended


def _tried(
    rows: Iterable[CharacterRow], draper: str, workers: RowWorkers, in_flight: int
) -> Iterator[tuple[CharacterRow, Outcome]]:
    """One try of each row, as they end."""
    waiting, running = iter(rows), dict[Future[Outcome], CharacterRow]()
    while True:
        for row in islice(waiting, in_flight - len(running)):
            running[workers.submit(row, draper)] = row
        if not running:
            return
        for future in wait(running, return_when=FIRST_COMPLETED).done:
            yield running.pop(future), _outcome(future)


def _outcome(future: "Future[Outcome]") -> Outcome:
    try:
        return future.result()
    except Exception as error:  # of the pool or of Ray: `try_row` returns those of rows
        return Outcome(f"its process ended, for want of memory perhaps: {_last_line(error)}", has_ended=True)


def try_row(row: CharacterRow, draper: str) -> Outcome:
    """Drape a row by one thread, and say what became of it."""
    torch.set_num_threads(1)
    set_num_threads(1)
    try:
        drape_row(row, draper)
    except InputError as error:
        return Outcome(str(error), is_final=True)
    except Exception as error:  # whatever it is, the other rows go on
        return Outcome(f"{type(error).__name__}: {error}")
    return Outcome()


def _check_reachable(address: str) -> None:
    """Raises:
    OSError, ValueError: an address with a port where nobody listens, for which Ray would wait for minutes.
    """
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if host:
        socket.create_connection((host, int(port)), CONNECTION_SECONDS).close()


def _last_line(error: Exception) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[-1][:LONGEST_REASON]
