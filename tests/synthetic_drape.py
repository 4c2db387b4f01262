"""A ball for a head and straight strands on it, as a drape: no body model, no groom files."""

import numpy as np

from quaffure.hair import DrapeSequence

HEAD_CENTRE, HEAD_RADIUS = np.array([0.0, 0.0, 1.6]), 0.1


def ball(rings: int = 24) -> tuple[np.ndarray, np.ndarray]:
    """Vertices [v, 3] and outward faces [k, 3] of a closed sphere around the head's centre."""
    around = 2 * rings
    polar, azimuth = np.meshgrid(
        np.linspace(0, np.pi, rings), np.linspace(0, 2 * np.pi, around, endpoint=False), indexing="ij"
    )
    directions = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=-1)
    row, column = np.arange(rings - 1)[:, None] * around, np.arange(around)[None]
    a, b = row + column, row + (column + 1) % around
    faces = np.concatenate([np.stack([a, a + around, b], -1), np.stack([b, a + around, b + around], -1)]).reshape(-1, 3)
    return (HEAD_CENTRE + HEAD_RADIUS * directions.reshape(-1, 3)).astype(np.float32), faces.astype(np.int32)


def patch_of_strands(towards: tuple[float, float, float], vertices: int = 8) -> np.ndarray:
    """Straight strands [s, n, 3] of 3 cm standing on a small patch of the head in one direction."""
    spread = np.random.default_rng(0).uniform(-0.25, 0.25, (150, 3))
    outwards = np.array(towards) + spread
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    reach = HEAD_RADIUS + np.linspace(0.0, 0.03, vertices)
    return (HEAD_CENTRE + outwards[:, None] * reach[None, :, None]).astype(np.float32)


def drape(strands: np.ndarray, frames: int = 3) -> DrapeSequence:
    """The strands moved 1 mm to +x each frame, on a head that stands still."""
    vertices, faces = ball()
    steps = np.arange(frames, dtype=np.float32)[:, None, None, None] * np.array([1e-3, 0, 0], dtype=np.float32)
    return DrapeSequence(
        strands=strands + steps,
        posed=np.repeat(strands[None], frames, axis=0),
        rest_lengths=np.linalg.norm(np.diff(strands, axis=1), axis=-1),
        body_vertices=np.repeat(vertices[None], frames, axis=0),
        body_faces=faces,
        body_pose=np.zeros((frames, 81), dtype=np.float32),
        body_shape=np.zeros(10, dtype=np.float32),
        fps=30.0,
        meta={"groom": "patch", "draper": "none"},
    )


def through_the_ear() -> np.ndarray:
    """A strand of 24 vertices that leads from above an ear through it, as on a head with another ear [m]."""
    corners = np.array([[0.0764, -0.047, 1.7403], [0.0733, -0.0533, 1.6905], [0.045, -0.0561, 1.6212]])
    place = np.linspace(0, 2, 24)
    return np.stack([np.interp(place, [0, 1, 2], axis) for axis in corners.T], axis=1).astype(np.float32)
