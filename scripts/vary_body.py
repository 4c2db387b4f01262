"""The shipped body with other proportions, to train on.

    python scripts/vary_body.py OUT.npz [--neck METRES] [--shoulders METRES] [--head FACTOR]

Vertices move with the joints that move them, by their skin weights; shapes and poses work as on the shipped body.
"""

import argparse
from importlib.resources import files
from pathlib import Path

import numpy as np

from quaffure.body import BodyModel, load_body
from quaffure.io import replacing

NECK_SHARES = {"Neck": 0.3, "Neck1": 0.7, "Head": 1.0}
"""Share of the neck's change that the skin of each joint moves by."""
SHOULDER_SHARES = {"Shoulder": 0.5, "Arm": 1.0, "ForeArm": 1.0, "Hand": 1.0, "FingerBase": 1.0}


def main(path: Path, neck: float, shoulders: float, head: float) -> None:
    """
    Args:
        neck: what it is longer [m].
        shoulders: what each is farther from the middle [m].
        head: size in sizes of before, about the joint of the head.
    """
    body = load_body()
    names, weights = list(body.joint_names), body.dense_skin_weights.numpy()
    moves = np.zeros((len(names), 3))
    for name, share in NECK_SHARES.items():
        moves[names.index(name), 2] = share * neck
    for side, sign in (("Left", 1), ("Right", -1)):
        for part, share in SHOULDER_SHARES.items():
            moves[names.index(side + part), 0] = sign * share * shoulders
    with np.load(str(files("quaffure") / "assets" / "body.npz"), allow_pickle=False) as shipped:
        arrays = dict(shipped)
    arrays["rest_vertices"] = (_vertices_with_head(body, head) + weights @ moves).astype(np.float32)
    arrays["rest_joints"] = (body.rest_joints.numpy() + moves).astype(np.float32)
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)


def _vertices_with_head(body: BodyModel, size: float) -> np.ndarray:
    vertices, joint = body.rest_vertices.numpy(), body.joint_names.index("Head")
    share = body.dense_skin_weights.numpy()[:, joint, None]
    return vertices + share * (size - 1) * (vertices - body.rest_joints.numpy()[joint])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("path", type=Path, metavar="OUT.npz")
    parser.add_argument("--neck", type=float, default=0.0, metavar="M", help="what the neck is longer [m]")
    parser.add_argument("--shoulders", type=float, default=0.0, metavar="M", help="what each is farther outwards [m]")
    parser.add_argument("--head", type=float, default=1.0, metavar="FACTOR", help="size of the head")
    main(**vars(parser.parse_args()))
