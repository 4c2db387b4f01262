"""Frame of a picture of a drape: a box around hair and head, and the direction that the body faces."""

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from quaffure.hair.drape_sequence import DrapeSequence

# A ball of this radius around the mean root contains the face and the chin of any adult head.
HEAD_RADIUS = 0.24  # m
MARGIN = 1.12
MOST_FRAMES = 4
"""Rows of a contact sheet."""


def frames_of_picture(count: int) -> list[int]:
    """Frames that the picture of a drape shows: all of up to four, else four evenly spaced from the first to the last.

    Args:
        count: frames of the drape.
    """
    return [int(frame) for frame in np.linspace(0, count - 1, min(MOST_FRAMES, count)).round()]


def facing_deg(seq: DrapeSequence, frame: int) -> float:
    """Rotation of the hips from -y about the vertical [deg], in the sense of a camera's azimuth."""
    hips = Rotation.from_rotvec(seq.body_pose[frame, :3])
    x, y, _ = hips.apply([0.0, -1.0, 0.0])
    return float(np.degrees(np.arctan2(x, -y)))


def frame_hair(seq: DrapeSequence) -> tuple[Float[np.ndarray, "3"], float]:
    """Centre and extent [m] of a cube that contains hair and head in every frame, for a camera that does not move."""
    boxes = [hair_box(strands, body) for strands, body in zip(seq.strands, seq.body_vertices)]
    lowest = np.min([low for low, _ in boxes], axis=0)
    highest = np.max([high for _, high in boxes], axis=0)
    return 0.5 * (lowest + highest), MARGIN * float((highest - lowest).max())


def hair_box(
    strands: Float[np.ndarray, "s n 3"], body: Float[np.ndarray, "v 3"]
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Lowest and highest corner [m] of a box around the hair and the body near the roots: the head."""
    near = body[np.linalg.norm(body - strands[:, 0].mean(axis=0), axis=1) < HEAD_RADIUS]
    points = np.concatenate([strands.reshape(-1, 3), near])
    return points.min(axis=0), points.max(axis=0)
