"""Registration: a groom from its own head, units and axes to strands on our scalp."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Int

from quaffure.body.body_model import BodyModel
from quaffure.config import VERTICES_PER_STRAND
from quaffure.errors import InputError
from quaffure.geometry.axes import axis_name
from quaffure.geometry.signed_distance import closest_barycentric
from quaffure.hair.clearance import inside_share, pushed_out_smoothly
from quaffure.hair.file_frame import MIRROR, UNKNOWN, FileFrame
from quaffure.hair.groom import Groom
from quaffure.hair.groom_alignment import GroomAlignment, align_groom, standing_groom
from quaffure.hair.groom_checks import LARGEST_COORDINATE
from quaffure.hair.head_alignment import Alignment, misfit, refine
from quaffure.hair.registration_report import (
    FARTHEST_ROOT,
    LARGEST_MEDIAN_RESIDUAL,
    ROOT_SLACK,
    Dropped,
    HeadFit,
    RegistrationReport,
)
from quaffure.hair.resample import (
    has_length,
    held_parts_by_strand,
    resample_by_arc_length,
    resample_held_parts,
    without_degenerate,
)
from quaffure.hair.scalp_target import head_target
from quaffure.hair.strands import UNASKED, Strands
from quaffure.types import Tensor

FEWEST_STRANDS = 20
LEAST_KEPT = 0.2  # of the strands
MOST_INSIDE = 5e-4  # of the vertices
MOST_INSIDE_ON_ARRIVAL = 0.4
"""Share of the vertices, without the roots: beyond it the fit is of the wrong side or size."""
LEAST_STANDING = 0.5
"""Share of the roots of a groom that stands on this body that are on its scalp; others are of brows or a beard."""
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


class _Details(NamedTuple):
    """Fields of a `RegistrationReport` that the alignment does not tell."""

    from_tip: Bool[np.ndarray, " s"]
    on_scalp: Bool[np.ndarray, " s"]
    inside_before: float
    inside_after: float
    head: HeadFit | None


def register_groom(
    strands: Strands,
    body: BodyModel,
    name: str,
    head: HeadMesh | None = None,
    licence: str = "",
    frame: FileFrame = UNKNOWN,
) -> tuple[Groom, RegistrationReport]:
    """Transform a groom to our scalp, resampled to the common number of vertices.

    Units, axes and position, as far as they are not known, are estimated by fitting the roots to the scalp (and the
    groom's own head, if given, to our head) with a similarity transform. Strands stored from tip to root are turned
    round, and those of a beard or of eyebrows are left out. Each strand is then translated so that its root is the
    nearest point of the scalp; strands are projected out of the body with their lengths kept. Their stiffness, goals
    and ties are kept, but for strands that are turned round. Strands of a groom that stands on this body already stay
    where they are, and are resampled only where they have another number of vertices.

    Args:
        frame: what is known of the file's axes and unit.

    Raises:
        InputError: too few strands, roots that do not cover a part of a head, or a poor fit; strands that reach beyond
            `LARGEST_COORDINATE`; strands said to stand on this body whose roots are not on its scalp.
    """
    usable, degenerate = without_degenerate(_mirrored(strands, frame))
    found, alignment, head_fit = _aligned(usable, body, head, frame)
    surface = body.rest_surface
    on_scalp = found.on_scalp
    aligned = alignment.transform(found.polylines[on_scalp])
    faces, barycentric, closest = nearest_on_scalp(torch.from_numpy(aligned[:, 0]).float(), body)
    offset = closest.double().numpy() - aligned[:, 0]
    residual = np.linalg.norm(offset, axis=1)
    near = residual <= (ROOT_SLACK if frame.registered else FARTHEST_ROOT)
    _check_fit(strands.source, residual, near, frame)
    kept = torch.from_numpy(np.flatnonzero(near))
    placed = torch.from_numpy((aligned if frame.registered else aligned + offset[:, None])[near]).float()
    if not frame.registered:
        placed[:, 0] = closest[kept]
    _check_reach(placed, strands.source)
    inside = inside_share(placed, surface)
    if inside > MOST_INSIDE_ON_ARRIVAL:
        fit = f"at most {100 * MOST_INSIDE_ON_ARRIVAL:g} % of the vertices inside the body (--up, --forward, --units)"
        raise InputError(strands.source, fit, f"{100 * inside:.0f} % in the best fit")
    rest = placed if frame.registered else pushed_out_smoothly(placed, surface)
    # Held parts count vertices from the root: a file that stores tips first knows none.
    parts = {} if found.turned else _held_parts(usable, frame)
    held_parts = {
        part: torch.from_numpy(_unasked_where(values, found.turned_strands, part)[on_scalp][near])
        for part, values in parts.items()
    }
    uv = body.scalp.uv_at(faces[kept], barycentric[kept])
    groom = Groom(name, rest, faces[kept], barycentric[kept], uv, licence, **held_parts)
    unused = Dropped(strands.dropped, degenerate, int((~near).sum()))
    details = _Details(*_of_the_file(strands, found, near), inside, inside_share(rest, surface), head_fit)
    return groom, _report(strands.source, frame, found, alignment, 1e3 * residual[near], unused, details)


def _of_the_file(
    strands: Strands, found: GroomAlignment, near: Bool[np.ndarray, " k"]
) -> tuple[Bool[np.ndarray, " s"], Bool[np.ndarray, " s"]]:
    """Whether each strand of the file is stored from its tip, and whether it stands on the scalp.

    Args:
        near: of the strands that are no beard or eyebrow, whether they are near enough to it.
    """
    is_hair = has_length(strands)
    from_tip, on_scalp = np.full(len(strands), found.turned), np.zeros(len(strands), dtype=bool)
    from_tip[is_hair] ^= found.turned_strands
    on_scalp[np.flatnonzero(is_hair)[found.on_scalp]] = near
    return from_tip, on_scalp


def _mirrored(strands: Strands, frame: FileFrame) -> Strands:
    return replace(strands, points=strands.points @ MIRROR.astype(np.float32)) if frame.mirror else strands


def _aligned(
    strands: Strands, body: BodyModel, head: HeadMesh | None, frame: FileFrame
) -> tuple[GroomAlignment, Alignment, HeadFit | None]:
    """Which strands are which, the transform to our body, and how a head fits ours."""
    if _keeps_vertices(strands, frame):
        polylines = strands.points.reshape(-1, VERTICES_PER_STRAND, 3).astype(np.float64)
    else:
        polylines = resample_by_arc_length(strands, VERTICES_PER_STRAND).astype(np.float64)
    if frame.registered:
        found = standing_groom(polylines, frame)
        return found, found.alignment, None
    _check_roots(polylines[:, 0], strands.source)
    found = align_groom(polylines, body, frame)
    if head is None:
        return found, found.alignment, None
    if frame.mirror:
        head = HeadMesh(head.vertices @ MIRROR, head.faces[:, ::-1])
    return found, *_align_heads(found.alignment, head, found.polylines[found.on_scalp][:, 0], body)


def _keeps_vertices(strands: Strands, frame: FileFrame) -> bool:
    return frame.registered and bool((strands.counts == VERTICES_PER_STRAND).all())


def _held_parts(strands: Strands, frame: FileFrame) -> dict[str, np.ndarray]:
    """Held parts, as in `Groom`, on the vertices that the strands get."""
    return held_parts_by_strand(strands) if _keeps_vertices(strands, frame) else resample_held_parts(strands)


def _unasked_where(values: np.ndarray, turned: Bool[np.ndarray, " s"], part: str) -> np.ndarray:
    result = values.copy()
    result[turned] = UNASKED[part]
    return result


def _report(
    source: str,
    frame: FileFrame,
    found: GroomAlignment,
    alignment: Alignment,
    residual: Float[np.ndarray, " k"],
    unused: Dropped,
    details: _Details,
) -> RegistrationReport:
    median, high, largest = np.quantile(residual, (0.5, 0.95, 1.0))
    rotation = alignment.transform.rotation @ (MIRROR if frame.mirror else np.eye(3))
    report = RegistrationReport(
        source=source,
        unit=alignment.unit,
        up_axis=axis_name(rotation[2]),
        forward_axis=axis_name(-rotation[1]),
        scale=alignment.transform.scale,
        rotation=rotation,
        translation=alignment.transform.translation,
        frame=frame,
        median_residual=float(median),
        p95_residual=float(high),
        max_residual=float(largest),
        kept=len(residual),
        unused=unused,
        beard=int(found.beard.sum()),
        eyebrows=int(found.eyebrow.sum()),
        turned=found.turned,
        turned_strands=int(found.turned_strands.sum()),
        **details._asdict(),
    )
    if report.inside_after > MOST_INSIDE and not frame.registered:
        raise InputError(
            source, f"at most {100 * MOST_INSIDE} % of vertices inside", f"{100 * report.inside_after:.3f} %"
        )
    return report


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


def _align_heads(
    alignment: Alignment, head: HeadMesh, roots: Float[np.ndarray, "s 3"], body: BodyModel
) -> tuple[Alignment, HeadFit]:
    """Fit the cranium of the groom's head, the part above its lowest root, to ours."""
    lowest = np.quantile(alignment.transform(roots)[:, 2], 0.02)
    vertices = head.vertices[np.unique(head.faces)]
    cranium = vertices[alignment.transform(vertices)[:, 2] > lowest]
    if len(cranium) < FEWEST_STRANDS:
        raise InputError("head", "a head that reaches above the roots of its groom", f"{len(cranium)} vertices there")
    target = head_target(body, lowest - 0.03)
    refined = refine(alignment, cranium, target, (0.9, 1.1))
    median, high = np.quantile(1e3 * misfit(refined.transform, cranium, target), (0.5, 0.95))
    return refined, HeadFit(float(median), float(high))


def _check_roots(roots: Float[np.ndarray, "s 3"], source: str) -> None:
    if len(roots) < FEWEST_STRANDS:
        raise InputError(source, f"at least {FEWEST_STRANDS} strands", str(len(roots)))
    values = np.linalg.svd(roots - roots.mean(0), compute_uv=False)
    in_one_point = values[0] <= 1e-6 * (1 + np.abs(roots).max())
    if in_one_point or values[2] < FLATTEST * values[0]:
        flat = "one point" if in_one_point else "a line or a plane"
        expected = "roots spread over a part of a head (of a groom in parts, name all files)"
        raise InputError(source, expected, f"roots in {flat}")


def _check_fit(source: str, residual: Float[np.ndarray, " s"], near: Bool[np.ndarray, " s"], frame: FileFrame) -> None:
    if frame.registered:
        if near.mean() < LEAST_STANDING:
            standing = f"most roots within {1e3 * ROOT_SLACK:g} mm of this body's scalp, as --registered says"
            raise InputError(source, standing, f"{int(near.sum())} of {len(near)} there")
        return
    if near.sum() < max(FEWEST_STRANDS, LEAST_KEPT * len(near)):
        reach = f"roots within {1e3 * FARTHEST_ROOT:.0f} mm of the scalp once aligned"
        raise InputError(source, reach, f"{int(near.sum())} of {len(near)} there")
    median = float(np.median(residual))
    if median > LARGEST_MEDIAN_RESIDUAL:
        fit = f"roots that fit a scalp to {1e3 * LARGEST_MEDIAN_RESIDUAL:.0f} mm in the median"
        raise InputError(source, fit, f"{1e3 * median:.1f} mm in the best of all units and axes")


def _check_reach(placed: Float[Tensor, "s n 3"], source: str) -> None:
    reaches = int((placed.abs() <= LARGEST_COORDINATE).all(dim=2).all(dim=1).sum())
    if reaches < len(placed):
        expected = f"strands within {LARGEST_COORDINATE:g} m of the body's origin"
        raise InputError(source, expected, f"{reaches} of {len(placed)} there")
