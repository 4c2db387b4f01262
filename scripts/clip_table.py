"""Clips by `CoherentDraper`: the table in docs/hanging.md.

python scripts/clip_table.py [FILE.bvh ...] [--styles STYLE ...]; idle, neck_turn, bow, and 150 frames of
each file.
"""

import time
from pathlib import Path

import torch
import tyro

from quaffure import load_motion
from quaffure.benchmark.appearance import JUMP_SPEED, jumps, velocity_changes
from quaffure.body import BodyModel, Motion, load_body
from quaffure.energies.body_collision import intersection_percent
from quaffure.hair import Groom
from quaffure.procedural import make_groom
from quaffure.scene import BodyBatch, Scene
from quaffure.solvers import CoherentDraper, StrandNewtonDraper
from quaffure.types import Positions

FPS, FRAMES = 30.0, 150
EVERY = 15
"""Frames between those that are draped alone as well, to compare energies and strands over the face."""
FACE = (0.05, 0.05, 0.05, 0.07)
"""Half the width of the face, how deep and how high it is above the tip of the nose, and how low below it [m]."""
COLUMNS = (
    "style", "clip", "frames", "jumps", "largest [mm]", "velocity change [mm]", "posed [mm]",
    "energy above frames alone, mean", "most", "more over the face", "inside %", "ms a frame",
)  # fmt: skip


def main(
    motions: tyro.conf.Positional[tuple[Path, ...]] = (), styles: tuple[str, ...] = ("long_straight", "ponytail")
) -> None:
    body = load_body()
    clips = [load_motion(motion, body) for motion in ("idle", "neck_turn", "bow", *motions)]
    print(f"| {' | '.join(COLUMNS)} |")
    print("|---" * len(COLUMNS) + "|")
    for name in styles:
        groom = make_groom(name, body)
        for clip in clips:
            print(f"| {' | '.join(_row(groom, body, clip))} |", flush=True)


def _row(groom: Groom, body: BodyModel, clip: Motion) -> list[str]:
    alone = StrandNewtonDraper()
    follower = CoherentDraper(alone)
    draped, posed, inside, above, more, milliseconds = [], [], [], [], [], []
    for frame, body_pose in enumerate(clip.body_pose[:FRAMES].split(1)):
        scene = Scene(groom, BodyBatch(body, body_pose, torch.zeros(1, 10)))
        posed.append(scene.posed)
        assert len(scene.surface.vertices)  # the body's search structures are not the draper's time
        begin = time.perf_counter()
        draped.append(follower.drape(scene))
        milliseconds.append(1000 * (time.perf_counter() - begin))
        inside.append(float(intersection_percent(draped[-1], scene)))
        if frame % EVERY == 0:
            energy = alone.energy_of(scene)
            by_itself = alone.drape(scene)
            difference = energy.total(draped[-1], scene) - energy.total(by_itself, scene)
            above.append(float(energy.per_vertex(difference)))
            more.append(_over_the_face(draped[-1], scene) - _over_the_face(by_itself, scene))
    moved = jumps(torch.cat(draped), torch.cat(posed))
    changes = [float(velocity_changes(torch.cat(hair)[:, :, -1]).median()) for hair in (draped, posed)]
    return [
        groom.name,
        clip.name,
        f"{len(draped)}",
        f"{int((moved > JUMP_SPEED / FPS).sum())}",
        f"{1000 * float(moved.max()):.0f}",
        *(f"{1000 * change:.1f}" for change in changes),
        f"{sum(above) / len(above):.3f}",
        f"{max(above):.3f}",
        f"{max(0, *more)}",
        f"{sum(inside) / len(inside):.3f}",
        f"{sorted(milliseconds)[len(milliseconds) // 2]:.0f}",
    ]


def _over_the_face(draped: Positions, scene: Scene) -> int:
    """Strands with a vertex in front of the face."""
    body, posed = scene.bodies.body, scene.bodies.posed
    head, rest = body.joint_names.index("Head"), body.rest_vertices
    in_front = rest[(rest[:, 2] > rest[:, 2].max() - 0.25) & (rest[:, 0].abs() < 0.03)]
    nose = in_front[in_front[:, 1].argmin()]
    hair = (draped[0] - posed.joint_positions[0, head]) @ posed.joint_rotations[0, head] + body.rest_joints[head]
    right, back, up = (hair - nose).unbind(dim=-1)
    width, depth, above, below = FACE
    return int(((right.abs() < width) & (back < depth) & (up < above) & (up > -below)).any(dim=1).sum())


if __name__ == "__main__":
    tyro.cli(main)
