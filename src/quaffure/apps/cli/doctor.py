"""`quaffure doctor`: what this machine has, what is missing for which feature, and how long a drape takes here."""

import os
import statistics
import time
from dataclasses import dataclass

import torch
from numba import get_num_threads

from quaffure.apps.cli.console import console, print_json, print_rows
from quaffure.benchmark.machine_facts import processor
from quaffure.body.body_model import load_body
from quaffure.body.clips import bundled_clip
from quaffure.draper import Draper
from quaffure.extras import EXTRAS, is_installed
from quaffure.io.load_groom import load_groom
from quaffure.model.inference_network import fast_bfloat16, lacks_bfloat16
from quaffure.model.quaffure_model import load_model
from quaffure.scene import BodyBatch, Scene
from quaffure.solvers.strand_newton import StrandNewtonDraper

FEATURES = {
    "alembic": "Alembic in and out (.abc)",
    "view": "the live page (quaffure view)",
    "render": "pictures and videos (.png, .mp4)",
    "usd": "USD in and out (.usd, .usda, .usdc, .usdz)",
    "docs": "plots of benchmarks",
    "onnx": "ONNX export (quaffure export-onnx)",
    "character": "bodies of characters (quaffure body import)",
    "ray": "tables of characters on a Ray cluster (quaffure crowd --ray)",
}
"""What each extra of the package is for."""
GROOM, CLIP, FRAME = "bob", "neck_turn", 36
DRAPES = 5


@dataclass(frozen=True)
class DoctorCommand:
    """What this machine has, what is missing for which feature, and how long a drape takes here."""

    json: bool = False
    """Print JSON instead of a table."""

    def run(self) -> None:
        console.quiet = self.json
        rows = [*_machine(), *_extras(), *_drapes()]
        print_json(rows) if self.json else print_rows(rows, "quaffure doctor")


def _machine() -> list[dict[str, str]]:
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9
    cards = [torch.cuda.get_device_name(index) for index in range(torch.cuda.device_count())]
    return [
        _row("processor", processor()),
        _row(
            "threads", f"{os.cpu_count()} processors; torch uses {torch.get_num_threads()}, numba {get_num_threads()}"
        ),
        _row("bfloat16", _bfloat16()),
        _row("memory", f"{memory:.1f} GB"),
        _row("card", ", ".join(cards) or "none that this torch can use; drapes run on the processor"),
    ]


def _bfloat16() -> str:
    if fast_bfloat16():
        return "in hardware (AMX)"
    return "none: train without --bf16" if lacks_bfloat16() else "for --bf16 alone; drapes are in float32"


def _extras() -> list[dict[str, str]]:
    rows = []
    for extra, feature in FEATURES.items():
        missing = [module for module in EXTRAS[extra] if not is_installed(module)]
        state = f"missing {', '.join(missing)}: pip install 'quaffure[{extra}]'" if missing else "installed"
        rows.append(_row(feature, state))
    return rows


def _drapes() -> list[dict[str, str]]:
    body = load_body()
    groom, pose = load_groom(GROOM, body), bundled_clip(CLIP, body).body_pose[FRAME : FRAME + 1]
    drapers: dict[str, Draper] = {"network": load_model().draper, "strand_newton": StrandNewtonDraper()}
    rows = []
    for name, draper in drapers.items():
        draper.drape(Scene(groom, BodyBatch(body, pose, torch.zeros(1, 10))))  # prepares the groom
        seconds = []
        for _ in range(DRAPES):
            scene = Scene(groom, BodyBatch(body, pose, torch.zeros(1, 10)))
            begin = time.perf_counter()
            draper.drape(scene)
            seconds.append(time.perf_counter() - begin)
        took = f"{1000 * statistics.median(seconds):.0f} ms ({len(groom)} strands of {GROOM}, median of {DRAPES})"
        rows.append(_row(f"a drape by {name}", took))
    return rows


def _row(what: str, found: str) -> dict[str, str]:
    return {"what": what, "found": found}
