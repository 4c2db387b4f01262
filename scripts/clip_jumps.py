"""Tips that jump in a clip, by method: `python scripts/clip_jumps.py --draper neural --draper strand_newton`.

Adds rows to docs/clip_jumps.json, from which `scripts/results_table.py` takes them. Every method drapes the frames as
`quaffure drape` runs it: `strand_newton` each from the last one, the others by themselves.
"""

import json
from pathlib import Path

import torch
import tyro

from quaffure.benchmark.drape_checks import DrapeChecks
from quaffure.benchmark.methods import methods
from quaffure.body import bundled_clip, load_body
from quaffure.draper import Draper
from quaffure.io.atomic import write_json
from quaffure.procedural import make_groom
from quaffure.scene import BodyBatch, Scene
from quaffure.solvers import CoherentDraper

OUT = Path(__file__).parents[1] / "docs" / "clip_jumps.json"
GROOM, CLIP = "long_straight", "neck_turn"
DEFAULT_ROWS = ("posed", "strand_newton", "neural", "neural_settled", "paper")


def main(draper: tyro.conf.UseAppendAction[tuple[str, ...]] = (), frames: str = "0:61") -> None:
    """
    Args:
        draper: rows of `quaffure evaluate`; may be given several times.
        frames: A:B:STEP of the clip; the neck turns from right to left in 0:61.
    """
    body = load_body()
    groom, clip = make_groom(GROOM, body), bundled_clip(CLIP, body).frames(frames)
    found = json.loads(OUT.read_text(encoding="utf-8")) if OUT.exists() else {}
    about = {"groom": GROOM, "strands": len(groom), "clip": CLIP, "frames": frames}
    rows = found["rows"] if found.get("about") == about else {}
    for method in methods(draper or DEFAULT_ROWS, {}):
        chosen: Draper = CoherentDraper() if method.name == "strand_newton" else method.draper
        checks = DrapeChecks(clip.fps)
        for body_pose in clip.body_pose.split(1):
            scene = Scene(groom, BodyBatch(body, body_pose, torch.zeros(1, 10)))
            checks.add(chosen.drape(scene), scene)
        rows[method.name] = sum(checks.jumping_tips) / (len(clip) - 1)
        print(f"{method.name}: {rows[method.name]:.2f} of {len(groom)} tips jump in a frame", flush=True)
        write_json(OUT, {"about": about, "rows": rows})


if __name__ == "__main__":
    tyro.cli(main)
