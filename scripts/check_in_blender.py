"""Compare what Blender imports with a drape file: `check_in_blender.py DRAPE.npz FILE.usd|FILE.abc ...`.

Needs a Python with bpy and numpy, and nothing of this package; the files are those of `quaffure render DRAPE.npz --out
FILE` without further options. Prints the largest distance of a vertex over all frames, and fails beyond 0.1 mm.
"""

import sys
from pathlib import Path

import bpy
import numpy as np

MOST_DISTANCE = 1e-4  # m


def imported_strands(path: Path) -> bpy.types.Object:
    """The curves object of the strands, in an empty scene."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    if path.suffix == ".abc":
        bpy.ops.wm.alembic_import(filepath=str(path))
    else:
        bpy.ops.wm.usd_import(filepath=str(path))
    found = [thing for thing in bpy.data.objects if thing.type == "CURVES" and thing.name.lower().startswith("strands")]
    assert len(found) == 1, [thing.name for thing in bpy.data.objects]
    return found[0]


def positions(curves: bpy.types.Object, frame: int, is_alembic: bool) -> np.ndarray:
    """Vertices of a frame, in the axes and units of the drape."""
    scene = bpy.context.scene
    scene.frame_set(frame)
    evaluated = curves.evaluated_get(bpy.context.evaluated_depsgraph_get())
    points = np.empty(3 * len(evaluated.data.points), np.float32)
    evaluated.data.points.foreach_get("position", points)
    points = points.reshape(-1, 3)
    if not is_alembic:
        world = np.array(evaluated.matrix_world)
        return points @ world[:3, :3].T + world[:3, 3]
    # Blender takes an Alembic file for y up: (X, -Z, Y). The file is (100 x, -100 y, 100 z).
    return np.stack([points[:, 0], -points[:, 2], -points[:, 1]], axis=1) / 100.0


def main(drape: Path, files: list[Path]) -> int:
    with np.load(drape) as arrays:
        expected, fps = arrays["strands"], float(arrays["fps"])
    worst = 0.0
    for path in files:
        curves = imported_strands(path)
        scene = bpy.context.scene
        scene.render.fps = round(fps)
        # Blender plays time code 0 of USD at frame 0, and the first second of Alembic at its frame 0.
        distances = [
            float(np.abs(positions(curves, frame, path.suffix == ".abc") - strands.reshape(-1, 3)).max())
            for frame, strands in enumerate(expected)
        ]
        largest, count = 1e3 * max(distances), len(curves.data.curves)
        print(f"{path.name}: {count} curves in {len(distances)} frames, worst {largest:.4f} mm")
        worst = max(worst, *distances)
    return int(worst > MOST_DISTANCE)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), [Path(name) for name in sys.argv[2:]]))
