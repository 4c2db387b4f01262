"""Choose the scalp among the faces of the baked body and unroll it to the unit square with little distortion."""

import numpy as np

from quaffure.character.scalp_chart import check_disc, edge_pairs, face_neighbours, fitted_to_square, unrolled

# The hairline of an adult on the mean body, in profile from its left side: (y, z) [m], y increasing to the back.
# In turn: forehead, receding corner, temple, sideburn, around the ear, down behind it, nape; then beyond the head.
HAIRLINE = np.array(
    [
        (-0.25, 1.792), (-0.146, 1.792), (-0.138, 1.789), (-0.128, 1.786), (-0.120, 1.777), (-0.107, 1.762),
        (-0.103, 1.745), (-0.099, 1.730), (-0.099, 1.700), (-0.078, 1.700), (-0.078, 1.726), (-0.062, 1.733),
        (-0.045, 1.733), (-0.030, 1.722), (-0.024, 1.710), (-0.022, 1.690), (-0.021, 1.665), (-0.018, 1.641),
        (0.005, 1.637), (0.050, 1.632), (0.2, 1.632), (0.2, 2.0), (-0.25, 2.0),
    ]
)  # fmt: skip
SMOOTHING_ROUNDS = 1


def bake_scalp(vertices: np.ndarray, faces: np.ndarray, ears: np.ndarray) -> dict[str, np.ndarray]:
    """Arrays `scalp_faces` [F] and `scalp_uv` [F, 3, 2] of the asset; prints distortion and coverage."""
    scalp_faces = scalp_region(vertices, faces, ears)
    used, flat = np.unique(faces[scalp_faces], return_inverse=True)
    points, patch = vertices[used].astype(np.float64), flat.reshape(-1, 3).astype(np.int64)
    check_disc(patch, "scalp")
    uv = symmetric(unrolled(points, patch), points)
    uv = fitted_to_square(uv)
    print_distortion(points, patch, uv)
    return {"scalp_faces": scalp_faces.astype(np.int32), "scalp_uv": uv[patch].astype(np.float32)}


def scalp_region(vertices: np.ndarray, faces: np.ndarray, ears: np.ndarray) -> np.ndarray:
    """Faces inside the hairline. Triangles 2i and 2i + 1 halve one of the source's quads and stay together."""
    centroids = vertices[faces].mean(1)
    quads = np.repeat(0.5 * (centroids[0::2] + centroids[1::2]), 2, axis=0)
    on_ear = np.isin(faces, ears).any(1)
    on_ear = np.repeat(on_ear[0::2] | on_ear[1::2], 2)
    inside = in_polygon(quads[:, 1:], HAIRLINE) & ~on_ear
    neighbours = face_neighbours(faces)
    for _ in range(SMOOTHING_ROUNDS):
        # Halves of quads that sit in the corner of a stair fill it; teeth go.
        inside |= (inside[neighbours].sum(1) >= 2) & ~on_ear
        inside &= inside[neighbours].sum(1) >= 2
    return np.flatnonzero(inside)


def in_polygon(points: np.ndarray, polygon: np.ndarray) -> np.ndarray:
    """Whether points lie inside a closed polygon: crossings of the ray along the first axis are odd."""
    start, end = polygon[:, None], np.roll(polygon, -1, axis=0)[:, None]
    spans = (start[..., 1] > points[:, 1]) != (end[..., 1] > points[:, 1])
    rise = np.where(end[..., 1] == start[..., 1], 1.0, end[..., 1] - start[..., 1])
    crossing = start[..., 0] + (points[:, 1] - start[..., 1]) / rise * (end[..., 0] - start[..., 0])
    return (spans & (crossing > points[:, 0])).sum(0) % 2 == 1


def symmetric(uv: np.ndarray, points: np.ndarray) -> np.ndarray:
    """The mean of a layout and of its mirror image, u = 0 on the midline."""
    distance = np.linalg.norm(points[:, None] * [-1, 1, 1] - points, axis=-1)
    twin = distance.argmin(1)
    if distance.min(1).max() > 1e-3 or (twin[twin] != np.arange(len(points))).any():
        raise RuntimeError(f"the scalp is not symmetric: {1e3 * distance.min(1).max():.2f} mm")
    middle = np.abs(points[:, 0]) < 1e-4
    uv = uv - uv[middle].mean(0)
    front, back = uv[middle][points[middle, 1].argmin()], uv[middle][points[middle, 2].argmin()]
    down = (back - front) / np.linalg.norm(back - front)
    uv = np.stack([uv @ [down[1], -down[0]], uv @ down], axis=1)
    return 0.5 * (uv + uv[twin] * [-1, 1])


def print_distortion(points: np.ndarray, patch: np.ndarray, uv: np.ndarray) -> None:
    """Singular values of the map from the surface to the chart, in units of its mean; share of the square."""
    first, second = edge_pairs(points, patch)
    along = first / np.linalg.norm(first, axis=1, keepdims=True)
    normal = np.cross(first, second)
    across = np.cross(normal / np.linalg.norm(normal, axis=1, keepdims=True), along)
    local = np.stack([np.stack([(v * along).sum(1), (v * across).sum(1)], axis=1) for v in (first, second)], axis=2)
    flat = np.stack(edge_pairs(uv, patch), axis=2)
    jacobian = flat @ np.linalg.inv(local)
    signs = np.linalg.det(jacobian)
    values = np.linalg.svd(jacobian, compute_uv=False)
    weight = np.linalg.norm(normal, axis=1)
    mean = np.sqrt(np.average(np.abs(signs), weights=weight))
    area = 0.5 * np.abs(np.linalg.det(flat)).sum()
    print(
        f"scalp chart: {int((signs <= 0).sum())} flipped, singular values {(values / mean).min():.2f}..."
        f"{(values / mean).max():.2f} of the mean, {100 * area:.1f} % of the square, "
        f"surface {0.5e4 * weight.sum():.0f} cm2"
    )
