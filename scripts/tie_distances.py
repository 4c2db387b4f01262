"""How far from its place on the posed head a tie holds its hair.

python scripts/tie_distances.py CLIP.bvh ...; the tied styles by `strand_newton`, some frames of the bundled neck_turn
and bow and of these clips, each draped alone.
"""

from pathlib import Path

import torch
import tyro

from quaffure import load_motion
from quaffure.body import load_body
from quaffure.procedural import STYLES, make_groom
from quaffure.scene import BodyBatch, Scene
from quaffure.solvers import StrandNewtonDraper

FRAMES = 4


def main(motions: tyro.conf.Positional[tuple[Path, ...]] = ()) -> None:
    """Print a row for each style and clip."""
    body, draper = load_body(), StrandNewtonDraper()
    clips = [load_motion(motion, body) for motion in ("neck_turn", "bow", *motions)]
    print("| style | clip | frames | tie vertices off [mm], mean | 95 % | 99 % | most | above 5 mm % |")
    print("|---|---|---|---|---|---|---|---|")
    for style in (name for name, style in STYLES.items() if style.ties):
        groom = make_groom(style, body)
        assert groom.tie_vertex is not None
        tied = torch.nonzero(groom.tie_vertex >= 0).flatten()
        for clip in clips:
            frames = torch.linspace(0, len(clip) - 1, FRAMES + 2).long()[1:-1]
            scene = Scene(groom, BodyBatch(body, clip.body_pose[frames], torch.zeros(FRAMES, 10)))
            off = (draper.drape(scene) - scene.posed)[:, tied, groom.tie_vertex[tied]].norm(dim=-1).flatten() * 1000
            shares = (f"{float(off.quantile(share)):.2f}" for share in (0.95, 0.99, 1.0))
            above = 100 * float((off > 5).float().mean())
            numbers = ", ".join(map(str, frames.tolist()))
            row = (style, clip.name, numbers, f"{float(off.mean()):.2f}", *shares, f"{above:.2f}")
            print(f"| {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    tyro.cli(main)
