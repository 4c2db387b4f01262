"""From a pose to strands with numpy, numba and onnxruntime, and without torch: what another runtime has to do.
quaffure export-onnx --groom bob --out out/network.onnx      # and out/network.npz, the constants of the drape
python examples/drape_without_torch.py out/network.onnx
"""

import sys
from pathlib import Path

import numpy as np
import onnxruntime
from numba import get_num_threads

from quaffure.body.head_frame_kernels import NO_OFFSETS, Skin, WorldJoints, pose_bodies
from quaffure.body.kinematics_kernel import Skeleton, forward_kinematics
from quaffure.hair.block_arrays import StrandBlocks
from quaffure.model.initial_shape_kernels import BodyArrays, RodBlocks, ShapeArrays, initial_shape_kernel
from quaffure.model.integration_kernel import ShapeRows, integrate_edges, rotate_edges
from quaffure.model.projection_kernel import PushedRods, PushSettings, push_out
from quaffure.model.surroundings_kernels import GridUnits, write_surroundings


def main(network: Path, pose: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """Strands [strand, vertex, 3] in the world [m] on a body in pose theta [1, 81], of shape beta [1, 10]."""
    gravity, stiffness = np.float32([0, 0, -1]), np.float32(1)  # [g], and a multiple of the hair's stiffness
    session, c, threads = onnxruntime.InferenceSession(network), np.load(network.with_suffix(".npz")), get_num_threads()
    refinement, rows = onnxruntime.InferenceSession(network.with_suffix(".refinement_1.onnx")), c["rows"].size
    joints = WorldJoints(pose, shape, *forward_kinematics(pose, shape, _part(Skeleton, c)), c["near"])
    frame, vertices, normals = pose_bodies(joints, _part(Skin, c), NO_OFFSETS)
    points, scalp, far = (part.copy() for part in np.split(vertices, c["parts"], axis=1))
    rotation, head, code, pull = *(values[0] for values in frame), gravity @ frame.world_from_head[0]
    radii, scalars = (c["radius"][()], c["per_radius"][()]), [c[name][()] for name in BodyArrays._fields[-4:]]
    body = BodyArrays(scalp, pull[None], points, normals, *radii, stiffness, *scalars)
    *space, features = (np.empty((1, rows, *of), np.float32) for of in ((3,), (23, 3), (23,), (c["feature_columns"],)))
    strands, bent = _part(StrandBlocks, c), ShapeArrays(*space, features.view(np.uint32))
    initial_shape_kernel(strands, _part(RodBlocks, c), c["rows"], body, int(c["passes"]), threads, bent)
    around = tuple(c[f"Surroundings.{name}"] for name in ("rest_length", "mass", "rest_density", "margin"))
    grid, seen = _part(GridUnits, c), bent.features[..., c["own_feature_columns"] :]
    write_surroundings(around, *bent[:2], grid, threads, seen)
    code = np.float32([*code, *pull, np.log(np.linalg.norm(gravity)), np.log(stiffness / np.linalg.norm(gravity))])[
        None
    ]
    inputs = {"groom_code": c["groom_code"], "texels": c["texels"], "pose_code": code, "features": features}
    changes, channels = session.run(None, inputs)
    edges, rotated, bits = ShapeRows(*(part[0] for part in bent[:3])), np.empty_like(bent.edges), (rows, 69)
    rotate_edges(edges, changes.view(np.uint32).reshape(bits), around[0], threads, rotated[0], bent.features[0])
    write_surroundings(around, bent.roots, rotated, grid, threads, seen)
    changes = changes + refinement.run(None, {"channels": channels, "features": features, "rotations": changes})[0]
    turns, order, rods = changes.view(np.uint32).reshape(bits), strands.strand.reshape(-1), _part(PushedRods, c)
    hair = integrate_edges(edges, turns, order, rods.rest_length, rotation, head, threads)
    skin = far[0] @ rotation.T + head, c["faces"], c["band"], head
    return push_out(hair, rods, _part(PushSettings, c)._replace(stiffness=stiffness), *skin)


def _part(kind, constants):
    return kind(*(constants[f"{kind.__name__}.{name}"][()] for name in kind._fields))


if __name__ == "__main__":
    print(main(Path(sys.argv[1]), np.zeros((1, 81), np.float32), np.zeros((1, 10), np.float32)).shape)
