"""Programs of others compared with our own drapers: the same strands, roots, body and weight, one criterion of rest.

    bash benchmarks/peers/set_up.sh dismech && bash benchmarks/peers/set_up.sh mujoco
    python benchmarks/peers/compare.py [--folder runs/peers] [--out peers.json]

Prints the table of docs/peers.md. Peers' runs and all drapes stay in the folder, so a stopped run goes on where it was.
A peer that is not set up is left out. All times are processor seconds of one thread.
"""

import argparse
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from numba import set_num_threads
from ours import Ours, our_drapers, timed_drape
from rest import TOLERANCE, Trace, arrival, extrapolated
from scene import add_scene_options, make_scene, write_scene
from their import PART_RUN, PEERS, WHOLE_RUN, PeerRun, installed, peer_run

from quaffure.benchmark.machine_facts import machine_facts
from quaffure.benchmark.metrics import metrics
from quaffure.energies import HairEnergy
from quaffure.errors import InputError
from quaffure.io import replacing
from quaffure.scene import Scene

STRANDS, MANY = 100, 2000
LONGEST_RUN = 10.0
"""What would take longer with many strands is not run but extrapolated, from runs with few and twice as many [s]."""
FIGURES = ("body_intersection_percent", "length_error_percent", "length_error_percent_max", "orientation_error_deg")


@dataclass(frozen=True)
class Row:
    """One program on the scene.

    Attributes:
        rest_seconds: to within the tolerance of its own end, 100 strands.
        whole_seconds: to its end.
        many_seconds: as `rest_seconds`, 2,000 strands.
        many_extrapolated: whether that was not run.
        end_speed: what still moves at the end [mm/s]; None for what is no simulation.
        compile_seconds, build_seconds: before anything moves; ours builds within its times.
    """

    name: str
    version: str
    energy: str
    rest_seconds: float
    whole_seconds: float
    many_seconds: float
    many_extrapolated: bool
    figures: dict[str, float]
    end_speed: float | None
    compile_seconds: float
    build_seconds: float | None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, default=Path("runs/peers"))
    parser.add_argument("--out", type=Path, help="all figures, as JSON")
    add_scene_options(parser)
    options = parser.parse_args()
    torch.set_num_threads(1)
    set_num_threads(1)
    options.folder.mkdir(parents=True, exist_ok=True)
    place = (options.groom, options.motion, options.frame)
    scenes = {count: make_scene(count, *place) for count in (STRANDS, 2 * STRANDS, MANY)}
    rows = [*_our_rows(scenes, options.folder), *_their_rows(scenes, options.folder)]
    print(table(rows))
    if options.out:
        _write(options.out, {"scene": place, "machine": machine_facts(), "rows": [asdict(row) for row in rows]})


def _write(path: Path, report: dict[str, object]) -> None:
    with replacing(path) as temporary:
        temporary.write_text(json.dumps({"tolerance_m": TOLERANCE, **report}, indent=1) + "\n")


def _their_rows(scenes: dict[int, Scene], folder: Path) -> Iterator[Row]:
    files = {count: folder / f"{count}.npz" for count in (STRANDS, 2 * STRANDS)}
    for count, file in files.items():
        if not file.exists():
            write_scene(file, scenes[count])
        with np.load(file, allow_pickle=False) as scene:
            _refuse_another(scene["strands"], scenes[count], file)
    for peer in PEERS:
        if not installed(peer):
            print(f"{peer} is left out: bash benchmarks/peers/set_up.sh {peer}")
            continue
        run = _run_on(scenes[STRANDS], peer, files[STRANDS], WHOLE_RUN)
        part = _run_on(scenes[2 * STRANDS], peer, files[2 * STRANDS], PART_RUN)
        growth = part.cost(PART_RUN) / run.cost(PART_RUN)
        rest = float(run.trace.cpu_seconds[arrival(run.trace)])
        yield Row(
            name=peer,
            version=run.version,
            energy="elastic rod",
            rest_seconds=rest,
            whole_seconds=float(run.trace.cpu_seconds[-1]),
            many_seconds=extrapolated(rest, growth, MANY / STRANDS),
            many_extrapolated=True,
            figures=_figures(run.trace, scenes[STRANDS]),
            end_speed=1000 * run.end_speed,
            compile_seconds=run.compile_seconds,
            build_seconds=run.build_seconds,
        )


def _run_on(scene: Scene, peer: str, file: Path, seconds: float) -> PeerRun:
    """The run of a peer, which must have begun where the scene's posed hair is.

    Raises:
        InputError: the folder keeps a run of another scene.
    """
    run = peer_run(peer, file, seconds)
    _refuse_another(run.trace.states[0], scene, file)
    return run


def _refuse_another(strands: np.ndarray, scene: Scene, file: Path) -> None:
    if not np.allclose(strands, scene.posed[0], atol=1e-5):
        raise InputError(file, "this scene and runs of it", "another (take another --folder)")


def _our_rows(scenes: dict[int, Scene], folder: Path) -> Iterator[Row]:
    for ours in our_drapers():
        print(f"{ours.name} ...", flush=True)
        trace, compile_seconds = ours.trace(scenes[STRANDS])
        np.savez(folder / f"ours_{ours.name.replace(', ', '_')}.npz", positions=trace.states[-1:])
        arrived = arrival(trace)
        rest = float(trace.cpu_seconds[arrived])
        many_seconds, is_extrapolated = _many_seconds(ours, arrived, rest, scenes)
        yield Row(
            name=ours.name if not ours.budgets else f"{ours.name}, {ours.budgets[arrived]}",
            version="ours",
            energy=ours.energy,
            rest_seconds=rest,
            whole_seconds=float(trace.cpu_seconds[-1]),
            many_seconds=many_seconds,
            many_extrapolated=is_extrapolated,
            figures=_figures(trace, scenes[STRANDS]),
            end_speed=None,
            compile_seconds=compile_seconds,
            build_seconds=None,
        )


def _many_seconds(ours: Ours, arrived: int, seconds: float, scenes: dict[int, Scene]) -> tuple[float, bool]:
    """Processor time for many strands with the budget that was enough for few, and whether it is extrapolated."""
    draper = ours.draper((ours.budgets or (0,))[arrived])
    if seconds * MANY / STRANDS <= LONGEST_RUN:
        return timed_drape(draper, scenes[MANY])[1], False
    growth = timed_drape(draper, scenes[2 * STRANDS])[1] / seconds
    return extrapolated(seconds, growth, MANY / STRANDS), True


def _figures(trace: Trace, scene: Scene) -> dict[str, float]:
    end = torch.from_numpy(trace.states[-1:]).float()
    measured = metrics(end, scene, HairEnergy(scene.groom))
    return {name: float(measured[name]) for name in FIGURES}


def table(rows: list[Row]) -> str:
    """The rows in Markdown."""
    titles = (
        "program", "energy", "to rest, 100 strands [s]", "to its end [s]", "to rest, 2,000 [s]", "inside body [%]",
        "stretch, mean [%]", "largest [%]", "from posed [deg]", "still moves [mm/s]", "compile [s]", "build [s]",
    )  # fmt: skip
    lines = [titles, ("---",) * len(titles)]
    for row in rows:
        many = ("~" if row.many_extrapolated else "") + _number(row.many_seconds)
        times = row.end_speed, row.compile_seconds, row.build_seconds
        first = row.name, row.energy, _number(row.rest_seconds), _number(row.whole_seconds), many
        lines.append((*first, *(_number(row.figures[name]) for name in FIGURES), *map(_number, times)))
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _number(value: float | None) -> str:
    if value is None:
        return ""
    return f"{value:.0f}" if value >= 100 else f"{value:.2g}"


if __name__ == "__main__":
    main()
