"""Registration: a groom from its own head, units and axes to strands on our scalp."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int

from quaffure.body.body_model import BodyModel
from quaffure.config import VERTICES_PER_STRAND
from quaffure.errors import InputError
from quaffure.geometry.signed_distance import closest_barycentric
from quaffure.geometry.surface import Surface
from quaffure.hair.clearance import inside_share, pushed_out, rest_surface
from quaffure.hair.groom import Groom
from quaffure.hair.groom_alignment import align_groom
from quaffure.hair.head_alignment import Alignment, refine
from quaffure.hair.resample import resample_by_arc_length, resample_held_parts, without_degenerate
from quaffure.hair.scalp_target import head_target
from quaffure.hair.strands import Strands
from quaffure.types import Tensor

FARTHEST_ROOT = 0.035
"""Largest distance of a root from the scalp [m]; others are dropped."""
FEWEST_STRANDS = 20
LARGEST_MEDIAN_RESIDUAL = 0.012  # m
LEAST_KEPT = 0.2  # of the strands
MOST_INSIDE = 5e-4  # of the vertices
# Smallest ratio of the third singular value of the roots to the first: below, they are on a line or a plane.
FLATTEST = 0.03
NEIGHBOURS = 16  # scalp triangles tried for the nearest point of a root


@dataclass(frozen=True)
class HeadMesh:
    """The head of a groom, in the groom's units and axes.

    Attributes:
        vertices: [file units].
        faces: triangles.
    """

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "k 3"]


@dataclass(frozen=True)
class RegistrationReport:
    """Estimates and residuals of a registration.

    Attributes:
        source: the file of the strands.
        unit: of the file: m, cm, mm, inch, or its size where it has no name.
        up_axis: of the file, as in "+y".
        scale: metres in a file unit.
        rotation: from the file's axes to ours.
        median_residual, p95_residual, max_residual: distance of the aligned roots from the scalp, kept strands [mm].
        kept, dropped: strands; dropped are those without length or too far from the scalp.
        beard: strands left out because they grow on the lower face.
        turned: whether the file stores strands from tip to root.
        inside_before, inside_after: share of vertices, without the roots, inside the body: when aligned and at the end.
    """

    source: str
    unit: str
    up_axis: str
    scale: float
    rotation: Float[np.ndarray, "3 3"]
    median_residual: float
    p95_residual: float
    max_residual: float
    kept: int
    dropped: int
    beard: int
    turned: bool
    inside_before: float
    inside_after: float

    def __str__(self) -> str:
        turned = "; strands stored from tip to root, turned round" if self.turned else ""
        beard = f", and {self.beard} of a beard left out" if self.beard else ""
        return (
            f"{self.source}: read in {self.unit} with {self.up_axis} up (1 unit = {1e3 * self.scale:.4g} mm){turned}; "
            f"{self.kept} strands kept, {self.dropped} dropped{beard}; roots {self.median_residual:.1f} mm from the "
            f"scalp in the median, {self.p95_residual:.1f} mm at 95 %, {self.max_residual:.1f} mm at most; "
            f"{100 * self.inside_before:.2f} % of the vertices inside the body on arrival, "
            f"{100 * self.inside_after:.3f} % now."
        )


def register_groom(
    strands: Strands,
    body: BodyModel,
    name: str,
    head: HeadMesh | None = None,
    licence: str = "",
    surface: Surface | None = None,
) -> tuple[Groom, RegistrationReport]:
    """Transform a groom to our scalp, resampled to the common number of vertices.

    Units, axes and position are estimated by fitting the roots to the scalp (and the groom's own head, if given, to
    our head) with a similarity transform. Strands stored from tip to root are turned round, and those of a beard are
    left out. Each strand is then translated so that its root is the nearest point of the scalp; strands are projected
    out of the body with their lengths kept. Their stiffness, goals and ties are kept.

    Args:
        surface: of the body at rest, if available (`rest_surface`).

    Raises:
        InputError: too few strands, roots that do not cover a part of a head, or a poor fit.
    """
    usable, degenerate = without_degenerate(strands)
    polylines = resample_by_arc_length(usable, VERTICES_PER_STRAND).astype(np.float64)
    _check_roots(polylines[:, 0], strands.source)
    found = align_groom(polylines, body)
    polylines, alignment = found.polylines[~found.beard], found.alignment
    if head is not None:
        alignment = _align_heads(alignment, head, polylines[:, 0], body)
    surface = surface or rest_surface(body)
    aligned = alignment.transform(polylines)
    faces, barycentric, closest = nearest_on_scalp(torch.from_numpy(aligned[:, 0]).float(), body)
    offset = closest.double().numpy() - aligned[:, 0]
    residual = np.linalg.norm(offset, axis=1)
    near = residual <= FARTHEST_ROOT
    _check_fit(strands.source, residual, near)
    kept = torch.from_numpy(np.flatnonzero(near))
    placed = torch.from_numpy((aligned + offset[:, None])[near]).float()
    placed[:, 0] = closest[kept]
    rest = pushed_out(placed, surface)
    uv = body.scalp.uv_at(faces[kept], barycentric[kept])
    # Held parts count vertices from the root: a file that stores tips first knows none.
    parts = {} if found.turned else resample_held_parts(usable)
    held_parts = {name: torch.from_numpy(part[~found.beard][near]) for name, part in parts.items()}
    groom = Groom(name, rest, faces[kept], barycentric[kept], uv, licence, **held_parts)
    median, high, largest = 1e3 * np.quantile(residual[near], (0.5, 0.95, 1.0))
    report = RegistrationReport(
        strands.source, alignment.unit, alignment.up_axis, alignment.transform.scale, alignment.transform.rotation,
        float(median), float(high), float(largest), len(rest), degenerate + int((~near).sum()),
        int(found.beard.sum()), found.turned, inside_share(placed, surface), inside_share(rest, surface),
    )  # fmt: skip
    if report.inside_after > MOST_INSIDE:
        raise InputError(
            strands.source, f"at most {100 * MOST_INSIDE} % of vertices inside", f"{100 * report.inside_after:.3f} %"
        )
    return groom, report


def nearest_on_scalp(
    points: Float[Tensor, "p 3"], body: BodyModel
) -> tuple[Int[Tensor, " p"], Float[Tensor, "p 3"], Float[Tensor, "p 3"]]:
    """Body face, barycentric coordinates and position of the scalp's point closest to each of `points` [m]."""
    triangles = body.rest_vertices[body.faces[body.scalp.faces]]
    centroids = triangles.mean(1)
    faces, weights, closest = [], [], []
    for part in points.split(4096):
        near = torch.cdist(part, centroids).topk(min(NEIGHBOURS, len(centroids)), largest=False).indices
        candidates = triangles[near]
        barycentric, _ = closest_barycentric(part[:, None].expand(-1, near.shape[1], -1), candidates)
        positions = (barycentric[..., None] * candidates).sum(-2)
        best = (positions - part[:, None]).square().sum(-1).argmin(1)
        rows = torch.arange(len(part))
        faces.append(body.scalp.faces[near[rows, best]])
        weights.append(barycentric[rows, best])
        closest.append(positions[rows, best])
    return torch.cat(faces), torch.cat(weights), torch.cat(closest)


def _align_heads(alignment: Alignment, head: HeadMesh, roots: Float[np.ndarray, "s 3"], body: BodyModel) -> Alignment:
    """Fit the cranium of the groom's head, the part above its lowest root, to ours."""
    lowest = np.quantile(alignment.transform(roots)[:, 2], 0.02)
    vertices = head.vertices[np.unique(head.faces)]
    cranium = vertices[alignment.transform(vertices)[:, 2] > lowest]
    if len(cranium) < FEWEST_STRANDS:
        raise InputError("head", "a head that reaches above the roots of its groom", f"{len(cranium)} vertices there")
    return refine(alignment, cranium, head_target(body, lowest - 0.03), (0.9, 1.1))


def _check_roots(roots: Float[np.ndarray, "s 3"], source: str) -> None:
    if len(roots) < FEWEST_STRANDS:
        raise InputError(source, f"at least {FEWEST_STRANDS} strands", str(len(roots)))
    values = np.linalg.svd(roots - roots.mean(0), compute_uv=False)
    in_one_point = values[0] <= 1e-6 * (1 + np.abs(roots).max())
    if in_one_point or values[2] < FLATTEST * values[0]:
        flat = "one point" if in_one_point else "a line or a plane"
        raise InputError(source, "roots spread over a part of a head", f"roots in {flat}")


def _check_fit(source: str, residual: Float[np.ndarray, " s"], near: Bool[np.ndarray, " s"]) -> None:
    if near.sum() < max(FEWEST_STRANDS, LEAST_KEPT * len(near)):
        reach = f"roots within {1e3 * FARTHEST_ROOT:.0f} mm of the scalp once aligned"
        raise InputError(source, reach, f"{int(near.sum())} of {len(near)} there")
    median = float(np.median(residual))
    if median > LARGEST_MEDIAN_RESIDUAL:
        fit = f"roots that fit a scalp to {1e3 * LARGEST_MEDIAN_RESIDUAL:.0f} mm in the median"
        raise InputError(source, fit, f"{1e3 * median:.1f} mm in the best of all units and axes")
