"""Short trainings of equal settings, to compare what is trained: from random weights, on ringlets only."""

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

GROOM = "long_ringlets"
OPTIONS = (
    *("--groom", GROOM, "--steps", "500", "--runs", "4", "--frames", "2", "--bf16"),
    *("--learning-rate", "1.5e-3", "--warmup", "50", "--validate-every", "25"),
)


def train_shortly(run: Path, options: Sequence[str]) -> None:
    """Train on 4,000 samples; continues a stopped run.

    Raises:
        subprocess.CalledProcessError: the training failed, and has said why.
    """
    quaffure = str(Path(sys.executable).with_name("quaffure"))
    subprocess.run([quaffure, "train", "--out", str(run), *OPTIONS, *options], check=True)
