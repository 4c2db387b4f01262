"""Throughput of `quaffure crowd`, against `drape_many` and writing in one process with all threads.

    python benchmarks/characters.py FOLDER [--rows 1000] [--ray ADDRESS] [--json]

Both drape the same rows of one frame, of four styles and random shapes, and write them as .npz into FOLDER. The
reference makes the grooms before its time begins; the time of `quaffure crowd` is that of the whole command, from which
its start, the time of one row alone, is also stated. The reference runs half before and half after it, so that the
ratio stands on a machine whose load changes slowly.
"""

import argparse
import csv
import json
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

import quaffure as qf
from quaffure.apps.character_table import NAMES, CharacterRow
from quaffure.apps.cli.console import print_json
from quaffure.scene import BodyBatch, Scene

STYLES = ("bob", "long_straight", "long_wavy", "short_coils")
MOTION = "walk"
AT_ONCE = 8


def rows_of(folder: Path, count: int) -> list[CharacterRow]:
    """Rows of one frame each."""
    shapes = torch.randn(count, 10, generator=torch.Generator().manual_seed(0)).clamp(-2, 2)
    frames = len(qf.load_motion(MOTION))
    return [
        CharacterRow(
            STYLES[index % len(STYLES)], MOTION, str(folder / f"{index}.npz"), str(index % frames),
            " ".join(f"{value:.4f}" for value in shapes[index].tolist()),
        )
        for index in range(count)
    ]  # fmt: skip


def reference_seconds(rows: Sequence[CharacterRow], grooms: dict[str, qf.Groom], model: qf.Quaffure) -> float:
    """Time to drape the rows by `drape_many`, `AT_ONCE` at a time, and to write them."""
    body, motion, begin = model.body, qf.load_motion(MOTION), time.perf_counter()
    for first in range(0, len(rows), AT_ONCE):
        part = rows[first : first + AT_ONCE]
        poses = torch.stack([motion.body_pose[int(row.frames)] for row in part])
        shapes = torch.tensor([[float(value) for value in row.shape.split()] for row in part])
        own = [grooms[row.groom] for row in part]
        for index, hair in enumerate(model.drape_many(own, poses, shapes)):
            scene = Scene(own[index], BodyBatch(body, poses[index : index + 1], shapes[index : index + 1]))
            qf.save_drape(
                qf.DrapeSequence(
                    strands=hair[None].numpy(),
                    posed=scene.posed.numpy(),
                    rest_lengths=own[index].rest_lengths.numpy(),
                    body_vertices=scene.bodies.posed.vertices.numpy(),
                    body_faces=body.faces.numpy().astype(np.int32),
                    body_pose=poses[index : index + 1].numpy(),
                    body_shape=shapes[index].numpy(),
                    fps=motion.fps,
                    meta={"groom": own[index].name},
                ),
                part[index].out,
            )
    return time.perf_counter() - begin


def command_seconds(rows: Sequence[CharacterRow], table: Path, ray: str) -> float:
    """Time of `quaffure crowd`, whose rows are not there yet."""
    for row in rows:
        Path(row.out).unlink(missing_ok=True)
    with table.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(NAMES)
        writer.writerows([getattr(row, name) for name in NAMES] for row in rows)
    command = [sys.executable, "-m", "quaffure", "crowd", str(table), "--json", *(["--ray", ray] if ray else [])]
    begin = time.perf_counter()
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    seconds = time.perf_counter() - begin
    assert json.loads(run.stdout)["written"] == len(rows), run.stdout
    return seconds


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--rows", type=int, default=1000)
    parser.add_argument("--ray", default="", help="address of a running Ray cluster")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    rows, table = rows_of(options.folder, options.rows), options.folder / "characters.csv"
    model, grooms = qf.load_model(), {name: qf.load_groom(name) for name in STYLES}
    reference_seconds(rows[: 2 * AT_ONCE], grooms, model)  # prepares the grooms and loads the kernels
    half = len(rows) // 2
    reference = reference_seconds(rows[:half], grooms, model)
    start = command_seconds(rows[:1], table, options.ray)
    command = command_seconds(rows, table, options.ray)
    reference += reference_seconds(rows[half:], grooms, model)
    found = {
        "rows": len(rows),
        "drape_many_rows_a_second": len(rows) / reference,
        "crowd_rows_a_second": len(rows) / command,
        "start_seconds": start,
        "share": reference / command,
        "share_without_start": reference / max(command - start, 1e-9),
    }
    if options.json:
        print_json(found)
    else:
        print("\n".join(f"{name.replace('_', ' ')}: {value:.3g}" for name, value in found.items()))


if __name__ == "__main__":
    main()
