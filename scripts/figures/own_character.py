"""Hairstyles on an imported body, at rest and in a frame of a motion, from three sides: docs/figures/own_character.jpg.

    quaffure body import CHARACTER.glb --out my_body.npz
    python scripts/figures/own_character.py my_body.npz MOTION FRAME

The network drapes; its guides are drawn.
"""

import sys
from pathlib import Path

import numpy as np
import torch
from PIL import Image

import quaffure as qf
from quaffure.apps.render.camera import Camera
from quaffure.apps.render.scene import StrandRenderer
from quaffure.io.load_motion import load_motion

FIGURE = Path(__file__).parents[2] / "docs/figures/own_character.jpg"
STYLES, VIEWS, TILE, EXTENT, BELOW_HEAD = ("bob", "long_wavy", "ponytail"), ("front", "side", "back"), 230, 0.62, 0.05


def main(body_file: str, motion: str, frame: str) -> None:
    body = qf.load_body(body_file)
    model, head = qf.load_model().on(body), body.joint_names.index("Head")
    pose = torch.stack([torch.zeros(81), load_motion(motion, body, in_place=True).body_pose[int(frame)]])
    posed = body.pose(pose, torch.zeros(2, 10))
    rows = []
    with StrandRenderer(TILE, TILE) as renderer:
        for style in STYLES:
            hair, tiles = model.drape(qf.load_groom(style, body), pose), []
            for strands, vertices, joints in zip(hair, posed.vertices, posed.joint_positions):
                middle = joints[head].numpy() - [0, 0, BELOW_HEAD]
                cameras = [Camera.view(view, middle, EXTENT) for view in VIEWS]
                scene = strands.numpy(), vertices.numpy(), body.faces.numpy()
                tiles += [renderer.render(*scene, camera) for camera in cameras]
            rows.append(np.hstack(tiles))
    Image.fromarray(np.vstack(rows)).save(FIGURE, quality=80)


if __name__ == "__main__":
    main(*sys.argv[1:])
