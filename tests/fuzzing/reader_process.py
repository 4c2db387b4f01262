"""A process that reads files within limits (`tests.fuzzing.serving`): `python -m tests.fuzzing.reader_process`."""

import resource
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from quaffure import InputError, load_groom
from quaffure.apps.character_table import read_table
from quaffure.apps.cli.inputs import body_shape_of
from quaffure.baselines import load_groomgen
from quaffure.body import BodyModel, Character, frame_times, load_body, poses_at
from quaffure.extras import is_installed
from quaffure.frame_store import BatchState
from quaffure.hair import FileFrame
from quaffure.io import read_drape, read_groom, read_head, read_joint_map, read_source, usd_curves
from quaffure.io.read_character import read_character
from quaffure.io.read_motion import read_motion
from quaffure.io.read_strands import read_strands
from quaffure.model import load_groom_autoencoder, load_groom_encoder, load_network
from quaffure.training import DrapeFolder, RunFolder, run_folder
from tests.fuzzing.folders import of_folder
from tests.fuzzing.serving import serve
from tests.test_long_drapes import BATCH, TOTAL, WHOLE, batches
from tests.test_long_drapes import folder as continued

FREE_BYTES = 1 << 30
"""Limit of the memory, beyond what the process takes with all modules loaded."""
FRAME = FileFrame(up="z", forward="-y", units="cm")
"""Of strands to register: without it they are aligned from every axis and unit, which takes five times as long."""


def readers(body: BodyModel) -> dict[str, Callable[[Path], object]]:
    """By the name of the format (`tests.fuzzing.seeds`)."""
    return {
        **dict.fromkeys(("hair", "data", "bin", "tfx", "npy", "npz strands", "ply"), read_strands),
        "npz registered": lambda path: load_groom(path, body, frame=FRAME),
        "npz aligned": lambda path: load_groom(path, body),
        "npz groom": lambda path: (read_groom(path, body), read_source(path)),
        "npz drape": read_drape,
        "npz body": load_body,
        **dict.fromkeys(("npz motion", "npz amass", "bvh"), lambda path: read_motion(path, body)),
        **dict.fromkeys(("glb", "gltf", "fbx"), lambda path: _read_and_retarget(path, body)),
        "fbx parts": _read_and_pose,
        **dict.fromkeys(("obj", "ply head"), read_head),
        "toml joints": read_joint_map,
        **dict.fromkeys(("csv", "npz shape"), lambda path: body_shape_of(str(path))),
        "csv characters": read_table,
        "safetensors": load_network,
        "encoder": load_groom_encoder,
        "autoencoder": load_groom_autoencoder,
        "groomgen weights": load_groomgen,
        "groomgen drapes": of_folder(lambda path: _drapes(path, body)),
        "frames": of_folder(_resumed),
        "training logs": of_folder(_logs),
        # Without its process, whose start takes half a second: where the library ends this one, it would end that.
        **dict.fromkeys(("usda", "usdc", "usdz"), usd_curves._read_stage),
        **_alembic_reader(),
        "checkpoint": _state,
    }


def _read_and_retarget(path: Path, body: BodyModel) -> tuple[object, ...]:
    character = _read_and_pose(path)
    return character, read_motion(Path(f"{path}#0"), body) if character[0].animations else None


def _read_and_pose(path: Path) -> tuple[Character, list[object]]:
    """A character, and its meshes in the poses of its first animations."""
    character = read_character(path)
    posed = [
        mesh.posed(pose.world[0], pose.morph_weights.get(mesh.node, [None])[0])
        for animation in character.animations[:2]
        for pose in poses_at(character, animation, frame_times(animation, 30.0, 10_000))
        for mesh in character.meshes
    ]
    return character, posed


def _alembic_reader() -> dict[str, Callable[[Path], object]]:
    if not is_installed("alembic3d"):
        return {}
    from quaffure.io import alembic_curves

    return {"abc": alembic_curves._read_archive}


def _resumed(path: Path) -> tuple[object, ...]:
    """As a drape that is continued by `--resume`."""
    store = continued(path, resume=True)
    try:
        kept, state = len(store), store.draper_state
        if kept and [array.shape[1:] for array in store.frames()] != [array.shape[1:] for array in WHOLE]:
            raise InputError(path, "frames of the groom and the body", "others")  # as drape_motion
        for first, batch in zip(range(0, TOTAL, BATCH), batches()):
            if first >= kept:
                store.append(batch, BatchState(1.0))
        return [np.array(array) for array in store.frames()], state, store.milliseconds
    finally:
        store.close()


def _drapes(path: Path, body: BodyModel) -> tuple[object, ...]:
    folder = DrapeFolder(path, body)
    return folder.manifest, folder.groom, folder.read()


def _logs(path: Path) -> None:
    """As a training that continues."""
    run = RunFolder(path)
    run.rewind_logs(2)
    run.log("training", {"step": 3, "loss": 0.5})


def _state(path: Path) -> dict[str, Any]:
    # Counters hold the best score, which is infinite before a validation.
    state = RunFolder(path.parent).load({"identity": "fuzzed"}) or {}
    return {name: value for name, value in state.items() if name != "counters"}


def main() -> None:
    warnings.simplefilter("error", RuntimeWarning)
    known = readers(load_body())
    run_folder.code_version = lambda: "fuzzed"  # asks git, which takes longer than a file
    size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (size + FREE_BYTES,) * 2)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    serve(known)


if __name__ == "__main__":
    main()
