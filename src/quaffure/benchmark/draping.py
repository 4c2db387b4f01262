"""Frames of a case draped and timed, or fetched from the cache."""

import time
from statistics import median

import torch

from quaffure.benchmark.drape_cache import DrapeCache, TimedDrape
from quaffure.benchmark.drape_key import drape_key, draper_key
from quaffure.benchmark.evaluation_set import EvaluationCase
from quaffure.benchmark.machine_facts import machine, times_the_processor
from quaffure.benchmark.methods import Method
from quaffure.body.body_model import BodyModel
from quaffure.digest import array_digest
from quaffure.draper import Draper
from quaffure.energies.loading import Loading
from quaffure.errors import InputError
from quaffure.hair.groom_cache import GroomCache
from quaffure.scene import Scene
from quaffure.types import Float, Tensor

SLOW_SECONDS = 1.0
"""A drape that takes longer than this [s] is timed by the one run that makes it; others by `REPEATS` more."""
REPEATS = 5
WARM_UP_STRANDS = 8


class CaseDraper:
    """Drapes frames of cases by any method, one at a time, and caches them.

    Attributes:
        made, fetched: drapes made here and found in the cache so far.
    """

    def __init__(self, body: BodyModel, cache: DrapeCache) -> None:
        self.body, self.cache = body, cache
        self.made, self.fetched = 0, 0
        self._warm: set[str] = set()
        self._body_key = array_digest(
            body.rest_vertices, body.shape_directions, body.rest_joints, body.joint_shape_directions,
            body.skin_joints, body.skin_weights, body.faces,
        )  # fmt: skip
        self._drapers: dict[tuple[str, Loading], tuple[Draper, str]] = {}
        self._groom_keys: GroomCache[str] = GroomCache()

    def drape(self, method: Method, case: EvaluationCase, frame: int) -> TimedDrape | None:
        """One frame, counted within the case; None where the method cannot drape the groom under the case's loading.

        Raises:
            InputError: the draper returns NaN or infinity.
        """
        if not method.drapes(case.groom, self.body, case.loading):
            return None
        cached = self._cached(method, case, frame)
        if cached is not None:
            return cached
        draper, _ = self._draper(method, case.loading)
        if method.name not in self._warm:
            few = case.groom.select(torch.arange(min(WARM_UP_STRANDS, len(case.groom))))
            draper.drape(Scene(few, case.bodies(self.body, frame)))
            self._warm.add(method.name)
        drape = self._timed(draper, case, frame)
        if not bool(torch.isfinite(drape.strands).all()):
            raise InputError(method.name, f"finite vertices in {case.name}", "NaN or infinity")
        self.cache.put(self._key(method, case, frame), drape, case.name, case.frames[frame], method.name)
        self.made += 1
        return drape

    def known(self, method: Method, case: EvaluationCase, frame: int) -> TimedDrape | None:
        """The drape where the cache holds it."""
        return self._cached(method, case, frame) if method.drapes(case.groom, self.body, case.loading) else None

    def _cached(self, method: Method, case: EvaluationCase, frame: int) -> TimedDrape | None:
        drape = self.cache.get(self._key(method, case, frame))
        if drape is None or drape.strands.shape != case.groom.rest_strands.shape:
            return None
        self.fetched += 1
        return drape

    def _draper(self, method: Method, loading: Loading) -> tuple[Draper, str]:
        """A method's draper under a loading, and its key."""
        if (method.name, loading) not in self._drapers:
            draper = method.with_loading(loading)
            self._drapers[method.name, loading] = draper, draper_key(draper)
        return self._drapers[method.name, loading]

    def _timed(self, draper: Draper, case: EvaluationCase, frame: int) -> TimedDrape:
        strands, seconds = self._once(draper, case, frame)
        if seconds < SLOW_SECONDS:
            seconds = median(self._once(draper, case, frame)[1] for _ in range(REPEATS))
        return TimedDrape(strands, 1000 * seconds, machine())

    def _once(self, draper: Draper, case: EvaluationCase, frame: int) -> tuple[Float[Tensor, "s n 3"], float]:
        clock = time.process_time if times_the_processor() else time.perf_counter
        begin = clock()
        strands = draper.drape(Scene(case.groom, case.bodies(self.body, frame)))[0].detach()
        return strands, clock() - begin

    def _key(self, method: Method, case: EvaluationCase, frame: int) -> str:
        groom_key = self._groom_keys.of(case.groom, lambda: self.cache.groom_key(case.groom))
        pose = case.motion.body_pose[frame]
        return drape_key(self._draper(method, case.loading)[1], groom_key, self._body_key, pose, case.body_shape)
