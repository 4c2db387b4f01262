"""What a picture of a drape must show: all of the hair, over all frames, and the head."""

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from quaffure.groom.drape_sequence import DrapeSequence

# Around the middle of the roots, this ball holds face and chin of any adult head.
HEAD_RADIUS = 0.24  # m
MARGIN = 1.12


def facing_deg(seq: DrapeSequence, frame: int) -> float:
    """How far the hips are turned from -y about the vertical [deg], as a camera's azimuth counts."""
    hips = Rotation.from_rotvec(seq.body_pose[frame, :3])
    x, y, _ = hips.apply([0.0, -1.0, 0.0])
    return float(np.degrees(np.arctan2(x, -y)))


def frame_hair(seq: DrapeSequence) -> tuple[Float[np.ndarray, "3"], float]:
    """Centre and extent [m] of a cube that holds hair and head in every frame, for a camera that stands still."""
    lowest, highest = seq.strands.min(axis=(0, 1, 2)), seq.strands.max(axis=(0, 1, 2))
    for roots, body in zip(seq.strands[:, :, 0], seq.body_vertices):
        near = body[np.linalg.norm(body - roots.mean(axis=0), axis=1) < HEAD_RADIUS]
        if len(near):
            lowest, highest = np.minimum(lowest, near.min(axis=0)), np.maximum(highest, near.max(axis=0))
    return 0.5 * (lowest + highest), MARGIN * float((highest - lowest).max())
