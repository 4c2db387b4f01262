"""The shipped body's head fitted to another one: a scale along each axis, a pitch and a place, by closest points."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from quaffure.body.body_model import BodyModel
from quaffure.body.pose_features import HEAD
from quaffure.character.collision_surface import Triangles, closest_on
from quaffure.errors import InputError

ROUNDS = 30
WIDTHS = (0.03, 0.006)
"""Scale of the robust weight of a distance, in the first and the last round [m]."""
DAMPING = 1e-3
LARGEST_CHANGE = 0.1
"""Limit of a round for the pitch [rad] and the logarithms of the scales."""
SCALES = (0.5, 2.5)
"""Limits of a head's size relative to the shipped body's, along each axis."""


@dataclass(frozen=True)
class HeadFit:
    """x -> R(pitch) S (x - centre) + place.

    Attributes:
        scale: along the body's axes [-].
        pitch: rotation about the x axis [rad].
        centre: middle of the shipped body's head [m].
        place: middle of the other head [m].
    """

    scale: Float[np.ndarray, "3"]
    pitch: float
    centre: Float[np.ndarray, "3"]
    place: Float[np.ndarray, "3"]

    def __call__(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        return self.scale * (points - self.centre) @ self._turn.T + self.place

    @property
    def _turn(self) -> Float[np.ndarray, "3 3"]:
        return Rotation.from_rotvec([self.pitch, 0.0, 0.0]).as_matrix()


def fit_head(template: BodyModel, surface: Triangles, on_head: Bool[np.ndarray, " v"], source: str) -> HeadFit:
    """Fit the shipped body's head to the head of a closed surface.

    Args:
        on_head: vertices of the surface that the head moves.
        source: the file, for errors.

    Raises:
        InputError: a head of no size that hair of the shipped body could be scaled to.
    """
    own = head_mesh(template)
    moving = np.unique(own.faces)
    points = own.vertices[moving]
    other = np.isin(surface.faces, np.flatnonzero(on_head)).all(1)
    target = Triangles(surface.vertices, surface.faces[other])
    fit = _start(points, surface.vertices[on_head])
    for width in np.geomspace(*WIDTHS, ROUNDS):
        placed = fit(points)
        _, _, closest = closest_on(placed, target)
        back = surface.vertices[on_head][:: max(1, int(on_head.sum()) // len(points))]
        face, weights, _ = closest_on(back, Triangles(fit(own.vertices), own.faces))
        of_own = (weights[..., None] * own.vertices[own.faces[face]]).sum(1)
        fit = _step(fit, np.concatenate([points, of_own]), np.concatenate([closest, back]), width)
    if not (np.all(fit.scale > SCALES[0]) and np.all(fit.scale < SCALES[1])):
        expected = f"a head of {SCALES[0]:g} to {SCALES[1]:g} times the size of the shipped body's"
        raise InputError(source, expected, "x ".join(f"{value:.2f}" for value in fit.scale) + "x")
    return fit


def head_mesh(body: BodyModel) -> Triangles:
    """The faces of a body at rest that the head moves."""
    on_head = body.dense_skin_weights[:, body.joint_names.index(HEAD)] > 0.5
    faces = body.faces[on_head[body.faces].all(1)].numpy()
    return Triangles(body.rest_vertices.double().numpy(), faces)


def _start(points: Float[np.ndarray, "p 3"], other: Float[np.ndarray, "q 3"]) -> HeadFit:
    """From the top of the head, the tip of the nose, which is foremost, the back and the widest place."""
    spans, corners = [], []
    for head in (points, other):
        nose = head[head[:, 1].argmin()]
        upper = head[head[:, 2] > nose[2]]
        middle = 0.5 * (upper[:, 0].min() + upper[:, 0].max())
        corner = np.array([middle, nose[1], nose[2]])
        spans.append(np.array([np.ptp(upper[:, 0]), upper[:, 1].max() - nose[1], upper[:, 2].max() - nose[2]]))
        corners.append(corner)
    scale = spans[1] / spans[0]
    centre = points.mean(0)
    return HeadFit(scale, 0.0, centre, corners[1] + scale * (centre - corners[0]))


def _step(fit: HeadFit, points: Float[np.ndarray, "p 3"], targets: Float[np.ndarray, "p 3"], width: float) -> HeadFit:
    """One damped Gauss-Newton step in the logarithms of the scales, the pitch and the place."""
    turn, scaled = fit._turn, fit.scale * (points - fit.centre)
    residual = fit(points) - targets
    weight = 1.0 / (1.0 + (residual**2).sum(1) / width**2) ** 2
    jacobian = np.zeros((len(points), 3, 7))
    for axis in range(3):
        jacobian[:, :, axis] = scaled[:, axis, None] * turn[:, axis]
        jacobian[:, axis, 4 + axis] = 1.0
    jacobian[:, :, 3] = np.cross([1.0, 0.0, 0.0], scaled @ turn.T)
    flat, wide = jacobian.reshape(-1, 7), np.repeat(weight, 3)
    normal = (flat * wide[:, None]).T @ flat
    gradient = (flat * wide[:, None]).T @ residual.reshape(-1)
    step = np.linalg.solve(normal + DAMPING * np.diag(normal.diagonal()), -gradient)
    change = np.clip(step[:4], -LARGEST_CHANGE, LARGEST_CHANGE)
    scale, pitch = fit.scale * np.exp(change[:3]), fit.pitch + float(change[3])
    return replace(fit, scale=scale, pitch=pitch, place=fit.place + step[4:])
