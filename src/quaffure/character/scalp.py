"""The scalp of a character: that of the shipped body transferred, or one that a file shows."""

from typing import NamedTuple

import igl
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from quaffure.body.body_model import BodyModel
from quaffure.character.collision_surface import Triangles, closest_on, distance_to, neighbour_mean
from quaffure.character.head_fit import HeadFit, head_mesh
from quaffure.character.scalp_chart import check_disc, continued, disc, fitted_to_square, without_flips
from quaffure.character.scalp_check import check_scalp

SUBDIVISIONS = 2
"""How often the shipped scalp's triangles, a centimetre wide, are divided into four."""
PROJECTIONS, SMOOTHINGS = 4, 6
NEAR_EAR = 0.012  # m
NEAR_PATCH = 0.004
"""Distance of a triangle's middle from the transferred scalp, up to which it is part of it [m]."""
WIDER = 0.025
"""How far a hair mesh or a groom can move the hairline outwards from the transferred scalp's [m]."""
ON_SKIN = 0.005
"""Distance up to which a mesh of hair lies on the skin, and up to which the transferred scalp does [m]."""
THICKEST_HAIR, HAIR_STEP = 0.1, 0.006
"""How far above the scalp a mesh of hair can be, and the steps of the search for it: wigs stand off the back of a head
by 8 cm, and are made of strips with gaps between them [m]."""
ROOT_DISTANCE = 0.012
"""Distance of the scalp from the nearest root of a groom [m]."""
LEAST_VALUE = 0.5
"""Value of an attribute above which vertices are scalp."""


class Scalp(NamedTuple):
    """A scalp on a closed surface.

    Attributes:
        faces: of the surface.
        uv: of their corners, in the unit square.
    """

    faces: Int[np.ndarray, " f"]
    uv: Float[np.ndarray, "f 3 2"]


class TransferredScalp(NamedTuple):
    """The shipped body's scalp on another head.

    Attributes:
        mesh: finer than the shipped scalp, on the surface [m].
        uv: of its vertices.
    """

    mesh: Triangles
    uv: Float[np.ndarray, "p 2"]

    def distance(self, points: Float[np.ndarray, "q 3"]) -> Float[np.ndarray, " q"]:
        """Distance of points from it [m]."""
        return np.linalg.norm(closest_on(points, self.mesh)[2] - points, axis=1)


def ears_of(surface: Triangles, on_head: Bool[np.ndarray, " v"], template: BodyModel, fit: HeadFit) -> np.ndarray:
    """Vertices of the ears: those of the head that are nearest to the fitted head's ears."""
    head = head_mesh(template)
    candidates = np.flatnonzero(on_head)
    face, _, closest = closest_on(surface.vertices[candidates], Triangles(fit(head.vertices), head.faces))
    on_ear = np.isin(head.faces[face], template.ear_vertices.numpy()).all(1)
    near = np.linalg.norm(closest - surface.vertices[candidates], axis=1) < NEAR_EAR
    return candidates[on_ear & near]


def transferred_scalp(
    template: BodyModel, surface: Triangles, ears: Int[np.ndarray, " e"], fit: HeadFit
) -> TransferredScalp:
    """The shipped scalp placed by the fit of the head and drawn onto the surface, smoothly, but not onto ears."""
    used, flat = np.unique(template.faces[template.scalp.faces].numpy(), return_inverse=True)
    patch = flat.reshape(-1, 3)
    uv = np.empty((len(used), 2))
    uv[patch] = template.scalp.uv.double().numpy()
    points = fit(template.rest_vertices[used].double().numpy())
    fine, faces = igl.upsample(np.hstack([points, uv]), patch, SUBDIVISIONS)
    faces = faces.astype(np.int64)
    points, uv = np.ascontiguousarray(fine[:, :3]), np.ascontiguousarray(fine[:, 3:])
    without_ears = Triangles(surface.vertices, surface.faces[~np.isin(surface.faces, ears).any(1)])
    mean = neighbour_mean(faces, len(points))
    for _ in range(PROJECTIONS):
        offset = closest_on(points, without_ears)[2] - points
        for _ in range(SMOOTHINGS):
            offset = 0.5 * (offset + mean @ offset)
        points = points + offset
    return TransferredScalp(Triangles(closest_on(points, without_ears)[2], faces), uv)


def scalp_of_transferred(
    transferred: TransferredScalp, surface: Triangles, ears: Int[np.ndarray, " e"], source: str
) -> Scalp:
    """The faces under the transferred scalp, with its chart.

    Raises:
        InputError: they are no disc.
    """
    middles = surface.vertices[surface.faces].mean(1)
    near = np.flatnonzero(transferred.distance(middles) < NEAR_PATCH)
    face, weights, _ = closest_on(middles[near], transferred.mesh)
    # The closest point of what is beside the scalp lies on its rim.
    rim = np.isin(transferred.mesh.faces[face], igl.boundary_loop(transferred.mesh.faces))
    beside = (np.where(rim, 0.0, weights).sum(1) < 1e-6) & ~rim.all(1)
    inside = np.zeros(len(surface.faces), dtype=bool)
    inside[near[~beside]] = True
    chosen = _patch(surface, inside, ears, source)
    used, flat = np.unique(surface.faces[chosen], return_inverse=True)
    patch, points = flat.reshape(-1, 3), surface.vertices[used]
    uv = without_flips(points, patch, _extended_uv(points, transferred))
    if uv.min() < 0 or uv.max() > 1:
        uv = fitted_to_square(uv)
    return Scalp(np.flatnonzero(chosen), uv[patch])


def scalp_of_faces(
    wanted: Bool[np.ndarray, " k"],
    surface: Triangles,
    ears: Int[np.ndarray, " e"],
    transferred: TransferredScalp,
    source: str,
) -> tuple[Scalp, tuple[str, ...]]:
    """A scalp of given faces, in the shipped body's chart where it covers them, continued beyond; and what was mended.

    Raises:
        InputError: they are no scalp (`check_scalp`), or no disc.
    """
    chosen = _patch(surface, wanted, ears, source)
    notes = check_scalp(surface, wanted, chosen, ears, source)
    used, flat = np.unique(surface.faces[chosen], return_inverse=True)
    patch, points = flat.reshape(-1, 3), surface.vertices[used]
    uv = _extended_uv(points, transferred)
    held = np.flatnonzero(transferred.distance(points) < ON_SKIN)
    return Scalp(np.flatnonzero(chosen), continued(points, patch, uv, held)[patch]), notes


def where_large(
    points: Float[np.ndarray, "p 3"], mesh: Triangles, values: Float[np.ndarray, " v"]
) -> Bool[np.ndarray, " p"]:
    """Points at whose nearest places on a mesh more than half of the corners, by their weight there, are scalp by an
    attribute.

    Args:
        values: of the attribute, at the mesh's vertices.
    """
    face, weights, _ = closest_on(points, mesh)
    return ((values > LEAST_VALUE)[mesh.faces[face]] * weights).sum(1) > 0.5


def under_hair(
    surface: Triangles, hair: Triangles, inside: Bool[np.ndarray, " k"], apart: Float[np.ndarray, " k"]
) -> Bool[np.ndarray, " k"]:
    """Faces that a mesh of hair covers: those of the transferred scalp that have it near or above them, and those
    beside it on which it lies. Hair that hangs in front of a forehead or a neck does not grow there.

    Args:
        inside: faces of the transferred scalp.
        apart: distance of each face from it [m].
    """
    middles = surface.vertices[surface.faces].mean(1)
    covered = (apart < WIDER) & (distance_to(middles, hair) < ON_SKIN)
    open_ = np.flatnonzero(inside & ~covered)
    normals = igl.per_face_normals(surface.vertices, surface.faces[open_], np.zeros(3))
    heights = np.arange(0.0, THICKEST_HAIR, HAIR_STEP)
    above = middles[open_, None] + heights[:, None] * normals[:, None]
    near = distance_to(np.ascontiguousarray(above.reshape(-1, 3)), hair).reshape(len(open_), len(heights)) < HAIR_STEP
    covered[open_] = near.any(1)
    return covered


def around_roots(
    surface: Triangles, roots: Float[np.ndarray, "s 3"], apart: Float[np.ndarray, " k"]
) -> Bool[np.ndarray, " k"]:
    """Faces near roots of a groom, not far outside of the transferred scalp.

    Args:
        apart: distance of each face from that scalp [m].
    """
    tree = cKDTree(roots)
    # Few strands: what is between them is scalp, too.
    spacing = float(np.median(tree.query(roots, 2)[0][:, 1])) if len(roots) > 1 else 0.0
    distance, _ = tree.query(surface.vertices[surface.faces].mean(1))
    return (distance < np.clip(1.5 * spacing, ROOT_DISTANCE, WIDER)) & (apart < WIDER)


def _patch(
    surface: Triangles, wanted: Bool[np.ndarray, " k"], ears: Int[np.ndarray, " e"], source: str
) -> Bool[np.ndarray, " k"]:
    chosen = disc(surface.faces, wanted & ~np.isin(surface.faces, ears).any(1))
    check_disc(surface.faces[chosen], source)
    return chosen


def _extended_uv(points: Float[np.ndarray, "p 3"], transferred: TransferredScalp) -> Float[np.ndarray, "p 2"]:
    """Chart of the transferred scalp at points near it; linear beyond its rim."""
    face, clamped, _ = closest_on(points, transferred.mesh)
    corners = transferred.mesh.faces[face]
    first, second, third = (transferred.mesh.vertices[corners[:, k]] for k in range(3))
    normal = np.cross(second - first, third - first)
    opposite = (second, third), (third, first), (first, second)
    weights = np.stack([(np.cross(b - points, c - points) * normal).sum(1) for b, c in opposite], axis=1)
    squared = (normal**2).sum(1)[:, None]
    # Triangles that are drawn over a sharp edge, of a hat for instance, may have no area.
    weights = np.where(squared > 0, weights / np.where(squared > 0, squared, 1.0), clamped)
    return (weights[..., None] * transferred.uv[corners]).sum(1)
