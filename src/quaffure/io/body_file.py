"""The body file: an imported body as one `.npz`, which `quaffure.load_body` reads."""

from pathlib import Path

import numpy as np

from quaffure.body.body_model import SHAPE_COUNT, BodyModel
from quaffure.io.atomic import replacing

WHOLE_NUMBERS = np.int16
"""Type of the shape directions, in units of their scales."""


def write_body(path: Path, body: BodyModel) -> None:
    """Write a body that was imported from a character, whole or not at all; its shape is its own.

    Raises:
        InputError: the folder of `path` is missing or not writable.
        ValueError: a body of several shapes, or without an origin.
    """
    if body.origin is None or body.shape_directions.any():
        raise ValueError("expected a body with an origin and of one shape")
    count = len(body.rest_vertices)
    arrays = {
        "rest_vertices": body.rest_vertices.numpy(),
        "shape_directions": np.zeros((SHAPE_COUNT, count, 3), WHOLE_NUMBERS),
        "shape_direction_scales": np.ones(SHAPE_COUNT, np.float32),
        "rest_joints": body.rest_joints.numpy(),
        "joint_shape_directions": body.joint_shape_directions.numpy(),
        "joint_parents": np.array(body.joint_parents, np.int32),
        "joint_names": np.array(body.joint_names),
        "skin_joints": body.skin_joints.numpy().astype(np.uint8),
        "skin_weights": body.skin_weights.numpy(),
        "faces": body.faces.numpy().astype(np.int32),
        "ear_vertices": body.ear_vertices.numpy().astype(np.int32),
        "scalp_faces": body.scalp.faces.numpy().astype(np.int32),
        "scalp_uv": body.scalp.uv.numpy(),
        "meta": np.array(body.meta),
        "file_from_body_scale": np.array(body.origin.scale),
        "file_from_body_rotation": body.origin.rotation,
        "file_from_body_translation": body.origin.translation,
        "file_name": np.array(body.origin.source),
        "file_digest": np.array(body.origin.digest),
        "file_joint_nodes": np.array(body.origin.joint_nodes),
    }
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]  # taken for numpy's allow_pickle
