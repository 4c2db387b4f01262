"""The scene that all peers drape: one groom on one posed body, written as plain arrays.

    python benchmarks/peers/scene.py --out scene.npz [--strands 100] [--groom curly_bob] [--motion nod --frame 22]

Peers run in environments of their own, without this package, so the file holds all they need. Lengths in metres, z up.

    strands [S,N,3]         the groom posed with the head: the shape without stress, from which peers start
    body_vertices [V,3], body_faces [K,3]   the posed skin, closed, normals outwards
    body_parts [V]          the joint that moves each vertex most, for programs that need convex bodies
    linear_density          of a strand [kg/m], as in our own energy
    bend_stiffness, twist_stiffness   EI, GJ of a real hair [N m^2], as in docs/validation.md; not part of our energy
    strand_radius           only for contact [m]
    gravity                 along -z [m/s^2]
"""

import argparse
from pathlib import Path

import numpy as np
import torch

from benchmarks.rods.heavy_rod import HeavyRod
from quaffure.body import BodyModel, bundled_clip, load_body
from quaffure.config import STANDARD_GRAVITY, HairMaterial
from quaffure.geometry import farthest_points
from quaffure.io import replacing
from quaffure.io.load_groom import load_groom
from quaffure.scene import BodyBatch, Scene

GROOM, MOTION, FRAME = "curly_bob", "nod", 22
STRAND_RADIUS = 1e-3
"""Peers keep this far from the body and twice this far between strands [m]; ours keeps up to 3 mm from the body."""


def make_scene(strands: int, groom: str = GROOM, motion: str = MOTION, frame: int = FRAME) -> Scene:
    """So many strands of a bundled groom, spread evenly over the scalp, on the mean body in one frame of a clip."""
    body = load_body()
    whole = load_groom(groom, body)
    kept = farthest_points(whole.rest_strands[:, 0].numpy(), strands)
    pose = bundled_clip(motion, body).body_pose[frame : frame + 1]
    return Scene(whole.select(torch.from_numpy(kept)), BodyBatch(body, pose, torch.zeros(1, 10)))


def write_scene(path: Path, scene: Scene) -> None:
    """Write the arrays that the module's docstring lists."""
    body, rod = scene.bodies.body, HeavyRod(length=1.0)
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez(
            file,
            strands=scene.posed[0].numpy(),
            body_vertices=scene.bodies.posed.vertices[0].numpy(),
            body_faces=body.faces.numpy(),
            body_parts=main_joints(body),
            linear_density=HairMaterial().linear_density,
            bend_stiffness=rod.bend,
            twist_stiffness=rod.twist,
            strand_radius=STRAND_RADIUS,
            gravity=STANDARD_GRAVITY,
        )


def main_joints(body: BodyModel) -> np.ndarray:
    """The joint with the largest skin weight of every vertex."""
    largest = body.skin_weights.argmax(dim=1, keepdim=True)
    return body.skin_joints.gather(1, largest).squeeze(1).numpy()


def add_scene_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--groom", default=GROOM)
    parser.add_argument("--motion", default=MOTION)
    parser.add_argument("--frame", type=int, default=FRAME)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--strands", type=int, default=100)
    add_scene_options(parser)
    options = parser.parse_args()
    write_scene(options.out, make_scene(options.strands, options.groom, options.motion, options.frame))


if __name__ == "__main__":
    main()
