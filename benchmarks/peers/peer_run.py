"""What the peers' runners share; runs in the environment of a peer, so it needs only numpy.

    python run_PEER.py scene.npz --out frames.npz [--seconds 2] [--strands S]

A peer starts at rest in the shape without stress, and swings under gravity until it is at rest. After every step all
velocities are multiplied by exp(-DRAG dt): one drag for all peers, near the critical one of a 20 cm pendulum.

The file holds positions [F,S,N,3] [m], simulated_seconds [F] and cpu_seconds [F] (processor time of the steps so far,
nothing else), compile_seconds, build_seconds and version.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Protocol, TypeVar

import numpy as np

DRAG = 12.0
"""Rate at which velocities decay [1/s]."""
FRAMES_PER_SECOND = 30
"""States kept of each simulated second."""

SceneArrays = dict[str, np.ndarray]
Result = TypeVar("Result")


class Peer(Protocol):
    """A program that has been given the scene."""

    time_step: float

    def step(self, keep: float) -> None:
        """One time step, after which velocities are multiplied by `keep`."""
        ...

    def positions(self) -> np.ndarray:
        """Vertices [S,N,3] [m]."""
        ...


def read_scene(path: Path, strands: int | None = None) -> SceneArrays:
    """The arrays of `scene.py`, with the first so many strands."""
    with np.load(path, allow_pickle=False) as file:
        scene = {name: file[name] for name in file.files}
    scene["strands"] = scene["strands"][:strands]
    return scene


def run(make: Callable[[SceneArrays], Peer], version: str) -> None:
    """The command line of a runner: drape the scene and write what came of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seconds", type=float, default=2.0, help="simulated")
    parser.add_argument("--strands", type=int, help="only the first so many")
    options = parser.parse_args()

    _, compile_seconds = _timed(lambda: _one_step(make(read_scene(options.scene, 2))))
    scene = read_scene(options.scene, options.strands)
    peer, build_seconds = _timed(lambda: make(scene))
    # A temporary file, then renamed: a run of minutes that is stopped leaves no half file.
    temporary = options.out.with_suffix(".part.npz")
    np.savez(
        temporary,
        compile_seconds=compile_seconds,
        build_seconds=build_seconds,
        version=version,
        time_step=peer.time_step,
        **_frames(peer, options.seconds),
    )
    temporary.replace(options.out)


def _frames(peer: Peer, seconds: float) -> dict[str, np.ndarray]:
    """States over time. Stops early when the peer has blown up."""
    keep = float(np.exp(-DRAG * peer.time_step))
    every = max(1, round(1 / (FRAMES_PER_SECOND * peer.time_step)))
    states, simulated, cpu, spent = [peer.positions()], [0.0], [0.0], 0.0
    for step in range(1, round(seconds / peer.time_step) + 1):
        start = time.process_time()
        peer.step(keep)
        spent += time.process_time() - start
        if step % every == 0:
            states.append(peer.positions())
            simulated.append(step * peer.time_step)
            cpu.append(spent)
            moved = 1000 * np.linalg.norm(states[-1] - states[-2], axis=-1).mean()
            print(f"{simulated[-1]:.3f} s simulated, {spent:.1f} s of processor time, moved {moved:.3f} mm", flush=True)
            if not np.isfinite(moved):
                break
    return {
        "positions": np.array(states, dtype=np.float32),
        "simulated_seconds": np.array(simulated),
        "cpu_seconds": np.array(cpu),
    }


def _one_step(peer: Peer) -> None:
    peer.step(1.0)


def _timed(work: Callable[[], Result]) -> tuple[Result, float]:
    start = time.process_time()
    return work(), time.process_time() - start
