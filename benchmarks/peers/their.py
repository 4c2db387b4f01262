"""Peers' runs: each in its own environment, by its runner, run where its file is missing."""

import os
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rest import Trace

HERE = Path(__file__).parent
PEERS = ("dismech", "mujoco")
WHOLE_RUN, PART_RUN = 2.0, 0.2
"""Simulated seconds of the run to rest, and of the one that measures how the cost grows."""
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


@dataclass(frozen=True)
class PeerRun:
    """What a runner wrote.

    Attributes:
        end_speed: mean speed of vertices over the last tenth of a second [m/s].
    """

    version: str
    trace: Trace
    simulated_seconds: np.ndarray
    compile_seconds: float
    build_seconds: float

    @property
    def end_speed(self) -> float:
        last = np.flatnonzero(self.simulated_seconds >= self.simulated_seconds[-1] - 0.1001)[0]
        moved = np.linalg.norm(self.trace.states[-1] - self.trace.states[last], axis=-1).mean()
        return float(moved / (self.simulated_seconds[-1] - self.simulated_seconds[last]))

    def cost(self, simulated: float) -> float:
        """Processor time of the first so many simulated seconds."""
        return float(np.interp(simulated, self.simulated_seconds, self.trace.cpu_seconds))


def installed(peer: str) -> bool:
    return _python(peer).exists()


def peer_run(peer: str, scene: Path, seconds: float) -> PeerRun:
    """The run of a peer on a scene file, which is kept in the folder of the scene.

    Raises:
        subprocess.CalledProcessError: the runner failed; it has said why.
    """
    out = scene.with_name(f"{peer}_{scene.stem}.npz")
    if not out.exists():
        command = [_python(peer), HERE / f"run_{peer}.py", scene, "--out", out, "--seconds", str(seconds)]
        # Warp keeps compiled kernels there: a folder of this benchmark's own, so that its first run compiles.
        environment = {**os.environ, **ONE_THREAD, "WARP_CACHE_PATH": str(scene.parent / "kernels")}
        subprocess.run([str(part) for part in command], check=True, env=environment)
    with np.load(out, allow_pickle=False) as file:
        return PeerRun(
            str(file["version"]),
            Trace(file["cpu_seconds"], file["positions"]),
            file["simulated_seconds"],
            float(file["compile_seconds"]),
            float(file["build_seconds"]),
        )


def _python(peer: str) -> Path:
    return HERE / "env" / peer / "bin" / "python"
