"""How far every fourth frame of a clip, draped without the others, is from the same frame of the whole clip.

    python scripts/frame_steps.py [FILE.bvh ...]; 120 frames of long_straight in neck_turn, bow and each file.

With passes and limits for the time between its frames, as in docs/solvers.md, and with those of 30 frames a second.
"""

from pathlib import Path

import torch
import tyro

from quaffure import load_motion
from quaffure.body import BodyModel, load_body
from quaffure.hair import Groom
from quaffure.procedural import make_groom
from quaffure.scene import BodyBatch, Scene
from quaffure.solvers import CoherentDraper
from quaffure.solvers.coherent_clip import FRAME_SECONDS
from quaffure.types import BodyPose, Positions

FRAMES, STEP = 120, 4


def main(motions: tyro.conf.Positional[tuple[Path, ...]] = ()) -> None:
    body = load_body()
    groom = make_groom("long_straight", body)
    print(f"| clip | every {STEP}th frame [mm] | with settings of 30 frames a second [mm] |")
    print("|---|---|---|")
    for clip in (load_motion(motion, body) for motion in ("neck_turn", "bow", *motions)):
        poses = clip.body_pose[:FRAMES]
        whole = _draped(groom, body, poses, FRAME_SECONDS)[::STEP]
        stepped = (_draped(groom, body, poses[::STEP], seconds) for seconds in (STEP * FRAME_SECONDS, FRAME_SECONDS))
        distances = (1000 * float((hair - whole).norm(dim=-1).mean()) for hair in stepped)
        print(f"| {clip.name} | {' | '.join(f'{distance:.0f}' for distance in distances)} |", flush=True)


def _draped(groom: Groom, body: BodyModel, poses: BodyPose, frame_seconds: float) -> Positions:
    draper = CoherentDraper()
    draper.frame_seconds = frame_seconds
    scenes = (Scene(groom, BodyBatch(body, pose, torch.zeros(1, 10))) for pose in poses.split(1))
    return torch.cat([draper.drape(scene) for scene in scenes])


if __name__ == "__main__":
    tyro.cli(main)
