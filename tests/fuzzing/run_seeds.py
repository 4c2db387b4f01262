"""Valid files and folders of trainings, of GroomGen's drapes, and of drapes that were interrupted."""

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import torch

from quaffure import HairMaterial
from quaffure.baselines import save_groomgen
from quaffure.body import BodyModel
from quaffure.hair import Groom
from quaffure.model import GroomAutoencoder
from quaffure.model.groom_code import save_autoencoder, save_encoder
from quaffure.training import RunFolder
from quaffure.training.groomgen_data import started_folder
from tests.fuzzing.folders import packed_folder
from tests.test_groomgen import LeaningDraper, network_of
from tests.test_long_drapes import filled

Write = Callable[[Path], object]


def written(write: Write, suffix: str) -> bytes:
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"seed{suffix}"
        write(path)
        return path.read_bytes()


def run_seeds(groom: Groom, body: BodyModel) -> dict[str, tuple[str, tuple[bytes, ...]]]:
    """As `tests.fuzzing.seeds.seeds`."""
    torch.manual_seed(0)
    network, few = GroomAutoencoder((1, 2, 3, 4)), groom.select(torch.arange(4))
    weights: dict[str, Write] = {
        "encoder": lambda path: save_encoder(path, network, {"step": "1"}),
        "autoencoder": lambda path: save_autoencoder(path, network, {"step": "1"}),
        "groomgen weights": lambda path: save_groomgen(path, network_of(few, body), HairMaterial(), {"step": "1"}),
    }
    folders: dict[str, Write] = {
        "groomgen drapes": lambda path: _drapes(path, few, body),
        "frames": lambda path: filled(path, 2).close(),
        "training logs": _logs,
    }
    return {name: (".safetensors", (written(write, ".safetensors"),)) for name, write in weights.items()} | {
        name: (".zip", (packed_folder(make),)) for name, make in folders.items()
    }


def checkpoint() -> bytes:
    with TemporaryDirectory() as folder:
        run = RunFolder(Path(folder))
        run.save({"identity": "fuzzed", "counters": torch.zeros(3), "network": {"weight": torch.ones(2, 3)}})
        return (run.path / "checkpoint.pt").read_bytes()


def _drapes(path: Path, groom: Groom, body: BodyModel) -> None:
    folder = started_folder(path, groom, body, "leaning", LeaningDraper(), seed=0)
    folder.drape(0, LeaningDraper())


def _logs(path: Path) -> None:
    run = RunFolder(path)
    for step in range(4):
        run.log("training", {"step": step, "seconds": 0.5 * step, "loss": 1 / (1 + step)})
    run.log("validation", {"step": 3, "stretch": 0.25})
