"""The picture at the top of the README: `python scripts/drape_picture.py DANCE.bvh`.

The shipped weights on six hairstyles: the neck turn of the paper's Fig. 6, then a dance clip, none trained on. The last
two styles were held out of all training.
"""

import sys
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from quaffure.body.body_model import BodyModel, load_body
from quaffure.body.clips import bundled_clip
from quaffure.body.motion import Motion, resample
from quaffure.drapers.drape_motion import drape_motion
from quaffure.drapers.quaffure_model import load_model
from quaffure.groom.guide_interpolation import interpolation_of
from quaffure.groom.procedural import make_groom
from quaffure.io.read_motion import read_motion
from quaffure.render.camera import Camera
from quaffure.render.contact_sheet import NATURAL_COLOURS
from quaffure.render.scene import StrandRenderer

OUT = Path(__file__).parents[1] / "docs" / "figures" / "drapes.jpg"
GROOMS = ("long_straight", "long_ringlets", "layered_shag", "ponytail", "side_part_lob", "mullet")
NECK_TURN, DANCE = (0, 22, 44, 66), (72, 90, 180, 252)
TILE_WIDTH, TILE_HEIGHT, EXTENT, BELOW_HEAD = 190, 230, 0.62, 0.10
STRANDS = 12_000
FPS = 30.0


def main(dance: str) -> None:
    body, model = load_body(), load_model()
    turn, danced = bundled_clip("neck_turn", body), resample(read_motion(Path(dance), body), FPS)
    rows = []
    with StrandRenderer(TILE_WIDTH, TILE_HEIGHT) as renderer:
        for name, colour in zip(GROOMS, NATURAL_COLOURS):
            groom, tiles = make_groom(name, body), []
            between = interpolation_of(groom, body, STRANDS)
            for motion, frames in ((turn, NECK_TURN), (danced, DANCE)):
                chosen = Motion(motion.body_pose[list(frames)], motion.fps, motion.name)
                drape = drape_motion(model.draper, groom, body, chosen, torch.zeros(10))
                tiles += [
                    _tile(between.strands(strands, vertices), vertices, body, body_pose, renderer, colour)
                    for strands, vertices, body_pose in zip(drape.strands, drape.body_vertices, chosen.body_pose)
                ]
            rows.append(np.hstack(tiles))
    Image.fromarray(np.vstack(rows)).save(OUT, quality=80, optimize=True)


def _tile(
    hair: np.ndarray, vertices: np.ndarray, body: BodyModel, body_pose: torch.Tensor, renderer: StrandRenderer,
    colour: tuple[float, float, float],
) -> np.ndarray:  # fmt: skip
    rotations, positions = body.posed_joints(body_pose[None], torch.zeros(1, 10))
    x, y, z = positions[0, body.joint_names.index("Head")].tolist()
    chest = rotations[0, body.joint_names.index("Spine1")]
    # From the chest's front and not the head's: that the head turns should be seen.
    facing = float(torch.rad2deg(torch.atan2(-chest[0, 1], chest[1, 1])))
    camera = Camera.three_quarter(np.array([x, y, z - BELOW_HEAD]), EXTENT, facing - 25)
    return renderer.render(hair, vertices, body.faces.numpy(), camera, colour)


if __name__ == "__main__":
    main(sys.argv[1])
