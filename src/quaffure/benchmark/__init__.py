"""Evaluation cases, metrics and tables that other methods can enter."""

from typing import TYPE_CHECKING

from quaffure._lazy import lazy_exports

if TYPE_CHECKING:
    from quaffure.benchmark.comparison import compare
    from quaffure.benchmark.drape_cache import DrapeCache
    from quaffure.benchmark.draping import CaseDraper
    from quaffure.benchmark.evaluation_set import (
        CaseEntry,
        DataFolders,
        EvaluationCase,
        GroomSource,
        load_cases,
        load_evaluation_set,
    )
    from quaffure.benchmark.methods import Method
    from quaffure.benchmark.metrics import (
        DrapeMetrics,
        accelerations,
        excess_energies,
        measure,
        vertices_from_head,
    )
    from quaffure.benchmark.solver_benchmark import run_benchmark
    from quaffure.energies.body_collision import intersection_percent

__all__, __getattr__, __dir__ = lazy_exports(__name__)
