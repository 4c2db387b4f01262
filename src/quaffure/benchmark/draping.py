"""Frames of a case draped and timed, or fetched from where they lie already."""

import os
import platform
import re
import time
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from statistics import median
from weakref import WeakKeyDictionary

import torch
from numba import get_num_threads

from quaffure.benchmark.drape_cache import DrapeCache, TimedDrape
from quaffure.benchmark.evaluation_set import EvaluationCase
from quaffure.benchmark.fingerprint import fingerprint
from quaffure.benchmark.methods import Competitor
from quaffure.body.body_model import BodyModel
from quaffure.draper import Draper
from quaffure.errors import InputError
from quaffure.hair.groom import Groom
from quaffure.scene import Scene
from quaffure.types import Float, Tensor

PATIENCE = 1.0
"""A drape that takes longer than this [s] is timed by the one run that makes it; others by `REPEATS` more."""
REPEATS = 5
WARM_UP_STRANDS = 8
CPU_INFO = Path("/proc/cpuinfo")


def machine() -> str:
    """What times are taken on."""
    # Python names the processor on few systems; Linux tells it here.
    told = re.search(r"model name\s*: (.+)", CPU_INFO.read_text()) if CPU_INFO.is_file() else None
    processor = told[1] if told else platform.processor() or platform.machine()
    threads = f"torch {torch.get_num_threads()}, numba {get_num_threads()} threads"
    return f"{processor}, {os.cpu_count()} processors, {threads}"


class CaseDraper:
    """Drapes frames of cases by any competitor, one at a time, and keeps them.

    Attributes:
        made, fetched: drapes made here and found in the cache so far.
    """

    def __init__(self, body: BodyModel, cache: DrapeCache) -> None:
        self.body, self.cache = body, cache
        self.made, self.fetched = 0, 0
        self._warm: set[str] = set()
        self._of_competitor: dict[str, str] = {}
        self._of_groom: WeakKeyDictionary[Groom, str] = WeakKeyDictionary()

    def drape(self, competitor: Competitor, case: EvaluationCase, frame: int) -> TimedDrape | None:
        """One frame, counted within the case; None where the competitor has no answer for the groom.

        Raises:
            InputError: the draper answers with NaN or infinity.
        """
        if not competitor.drapes(case.groom, self.body):
            return None
        known = self.known(competitor, case, frame)
        if known is not None:
            return known
        if competitor.name not in self._warm:
            few = case.groom.select(torch.arange(min(WARM_UP_STRANDS, len(case.groom))))
            competitor.draper.drape(Scene(few, case.bodies(self.body, frame)))
            self._warm.add(competitor.name)
        drape = self._timed(competitor.draper, case, frame)
        if not bool(torch.isfinite(drape.strands).all()):
            raise InputError(competitor.name, f"finite vertices in {case.name}", "NaN or infinity")
        self.cache.put(self._key(competitor, case, frame), drape, case.name, case.frames[frame], competitor.name)
        self.made += 1
        return drape

    def known(self, competitor: Competitor, case: EvaluationCase, frame: int) -> TimedDrape | None:
        """The drape where the cache holds it."""
        drape = self.cache.get(self._key(competitor, case, frame))
        if drape is None or drape.strands.shape != case.groom.rest_strands.shape:
            return None
        self.fetched += 1
        return drape

    def _timed(self, draper: Draper, case: EvaluationCase, frame: int) -> TimedDrape:
        strands, seconds = self._once(draper, case, frame)
        if seconds < PATIENCE:
            seconds = median(self._once(draper, case, frame)[1] for _ in range(REPEATS))
        return TimedDrape(strands, 1000 * seconds, machine())

    def _once(self, draper: Draper, case: EvaluationCase, frame: int) -> tuple[Float[Tensor, "s n 3"], float]:
        begin = time.perf_counter()
        strands = draper.drape(Scene(case.groom, case.bodies(self.body, frame)))[0].detach()
        return strands, time.perf_counter() - begin

    def _key(self, competitor: Competitor, case: EvaluationCase, frame: int) -> str:
        if competitor.name not in self._of_competitor:
            self._of_competitor[competitor.name] = fingerprint(competitor.draper)
        if case.groom not in self._of_groom:
            self._of_groom[case.groom] = self.cache.groom_key(case.groom)
        return fingerprint(
            version("quaffure"),
            self._of_competitor[competitor.name],
            self._body_fingerprint,
            self._of_groom[case.groom],
            case.motion.body_pose[frame],
            case.body_shape,
        )

    @cached_property
    def _body_fingerprint(self) -> str:
        return fingerprint(self.body)
