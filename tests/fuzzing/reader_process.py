"""A process that reads files as it is asked to, within limits: `python -m tests.fuzzing.reader_process`.

Each line of the standard input holds the name of a reader and a path; each line of the output is JSON with the outcome:
`read`, `refused` for an `InputError`, or `raised` for any other exception.
"""

import json
import resource
import sys
import time
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

from quaffure.apps.character_table import read_table
from quaffure.apps.cli.inputs import body_shape_of
from quaffure.body import BodyModel, load_body
from quaffure.body.character import Character
from quaffure.body.character_animation import frame_times, poses_at
from quaffure.errors import InputError
from quaffure.extras import is_installed
from quaffure.io import read_drape, read_head, usd_curves
from quaffure.io.groom_file import read_groom
from quaffure.io.load_groom import load_groom
from quaffure.io.read_character import read_character
from quaffure.io.read_motion import read_joint_map, read_motion
from quaffure.io.read_strands import read_strands
from quaffure.model.checkpoint import load_network
from quaffure.training.run_folder import RunFolder

FREE_BYTES = 1 << 30
"""Limit of the memory, beyond what the process takes with all modules loaded."""


def readers(body: BodyModel) -> dict[str, Callable[[Path], object]]:
    """By the name of the format (`tests.fuzzing.seeds`)."""
    return {
        **dict.fromkeys(("hair", "data", "bin", "tfx", "npy", "npz strands", "ply"), read_strands),
        "npz registered": lambda path: load_groom(path, body),
        "npz groom": lambda path: read_groom(path, body),
        "npz drape": read_drape,
        "npz body": load_body,
        **dict.fromkeys(("npz motion", "npz amass", "bvh"), lambda path: read_motion(path, body)),
        **dict.fromkeys(("glb", "gltf", "fbx"), lambda path: _read_and_retarget(path, body)),
        "fbx parts": _read_and_pose,
        **dict.fromkeys(("obj", "ply head"), read_head),
        "toml joints": read_joint_map,
        "csv": lambda path: body_shape_of(str(path)),
        "csv characters": read_table,
        "safetensors": load_network,
        # Without its process, whose start takes half a second: where the library ends this one, it would end that.
        **dict.fromkeys(("usda", "usdc", "usdz"), usd_curves._read_stage),
        **_alembic_reader(),
        "checkpoint": lambda path: RunFolder(path.parent).load({"identity": "fuzzed"}),
    }


def _read_and_retarget(path: Path, body: BodyModel) -> None:
    if _read_and_pose(path).animations:
        read_motion(Path(f"{path}#0"), body)


def _read_and_pose(path: Path) -> Character:
    character = read_character(path)
    for animation in character.animations[:2]:
        for pose in poses_at(character, animation, frame_times(animation, 30.0, 10_000)):
            for mesh in character.meshes:
                mesh.posed(pose.world[0], pose.morph_weights.get(mesh.node, [None])[0])
    return character


def _alembic_reader() -> dict[str, Callable[[Path], object]]:
    if not is_installed("alembic3d"):
        return {}
    from quaffure.io import alembic_curves

    return {"abc": alembic_curves._read_archive}


def outcome_of(read: Callable[[Path], object], path: Path) -> dict[str, Any]:
    """What became of a file."""
    start = time.process_time()
    said = ""
    try:
        read(path)
        outcome = "read"
    except InputError as error:
        outcome, said = "refused", str(error)
        if "\n" in said:
            outcome = "raised"
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        outcome, said = "raised", f"{type(error).__name__}: {error} ({Path(place.filename).name}:{place.lineno})"
    return {"outcome": outcome, "said": said, "seconds": time.process_time() - start}


def main() -> None:
    warnings.simplefilter("error", RuntimeWarning)
    known = readers(load_body())
    size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (size + FREE_BYTES,) * 2)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    print("ready", flush=True)
    for line in sys.stdin:
        name, path = json.loads(line)
        print(json.dumps(outcome_of(known[name], Path(path))), flush=True)


if __name__ == "__main__":
    main()
