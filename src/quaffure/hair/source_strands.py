"""Every strand of a groom's source, as an artist made it, driven by draped strands near it.

A draped groom has at most one strand in a texel of the scalp. Each strand of the source follows three of them: an edge
is turned as theirs are at the same arc length, relative to rest, and edges keep their lengths and order. A strand that
is itself draped is the curve of its drape, at its own arc lengths. Strands off the scalp (a beard, eyebrows) move
rigidly with the skin under their roots.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32, Int

from quaffure.body.body_model import BodyModel
from quaffure.errors import InputError
from quaffure.geometry.signed_distance import closest_points
from quaffure.geometry.surface import posed_surface
from quaffure.hair.driving_guides import driving_guides
from quaffure.hair.groom import Groom
from quaffure.hair.guide_interpolation import GuideInterpolation
from quaffure.hair.original_kernels import DrivenStrands, drive_strands, guide_rotations
from quaffure.hair.posing import triangle_frames, triangle_rotations
from quaffure.hair.registration import nearest_on_scalp
from quaffure.hair.registration_report import RegistrationReport
from quaffure.hair.resample import arc_length_places, values_at_places
from quaffure.hair.strand_attributes import NONE, StrandAttributes
from quaffure.hair.strands import Strands
from quaffure.types import Tensor


@dataclass(frozen=True, eq=False)
class PlacedStrands:
    """Strands of a source on the body at rest, as their registration placed them, in the order of the source.

    Attributes:
        points: vertices of all strands one after another, roots first [m, world].
        counts: vertices of each strand.
        from_tip: whether the source stores a strand from tip to root.
        on_scalp: whether a strand grows on the scalp; others are a beard, eyebrows, or too far from it.
        attributes: what else the source says of them, widths [m].
    """

    points: Float32[np.ndarray, "p 3"]
    counts: Int[np.ndarray, " s"]
    from_tip: Bool[np.ndarray, " s"]
    on_scalp: Bool[np.ndarray, " s"]
    attributes: StrandAttributes = NONE

    def __len__(self) -> int:
        return len(self.counts)

    @property
    def starts(self) -> Int[np.ndarray, " s"]:
        return np.cumsum(self.counts) - self.counts

    def select(self, kept: Bool[np.ndarray, " s"]) -> "PlacedStrands":
        """Some of the strands."""
        points = self.points[np.repeat(kept, self.counts)]
        attributes = self.attributes.select(kept, self.counts)
        return PlacedStrands(points, self.counts[kept], self.from_tip[kept], self.on_scalp[kept], attributes)


@dataclass(frozen=True, eq=False)
class OriginalStrands(GuideInterpolation):
    """Strands of a source, and what drives them, where others are invented between guides.

    Of `GuideInterpolation`, `weights` are all 0 where a strand moves with the skin, and `vertex_count` is that of the
    source where all strands have as many, else the largest.

    Attributes:
        placed: the strands at rest.
        own_guide: the draped strand that a strand is itself, -1 for none.
        root_offset: place of each root from its point of the face, in the face's frame [m].
        groom: the draped strands.
        body: that the groom is registered to.
    """

    placed: PlacedStrands
    own_guide: Int[np.ndarray, " m"]
    root_offset: Float32[np.ndarray, "m 3"]
    groom: Groom
    body: BodyModel

    def strands(
        self,
        guides: Float[np.ndarray, "g n 3"],
        body_vertices: Float[np.ndarray, "b 3"],
        out: Float32[np.ndarray, "m v 3"] | None = None,
    ) -> Float32[np.ndarray, "m v 3"]:
        """The strands of a frame with a common number of vertices, roots first [m, world]: shorter ones are resampled.
        `points` has them as they are.

        Args:
            guides, body_vertices: as of `points`.
            out: array for the result, if available.
        """
        points = self.points(guides, body_vertices)
        counts, vertices = self.placed.counts, self.vertex_count
        if (counts == vertices).all():
            result = points.reshape(len(self), vertices, 3)
        else:
            places = arc_length_places(Strands(points, counts, "strands"), vertices)
            result = values_at_places(points, *places).astype(np.float32)
        if out is None:
            return result
        out[:] = result
        return out

    @property
    def counts(self) -> Int[np.ndarray, " m"]:
        return self.placed.counts

    @property
    def attributes(self) -> StrandAttributes:
        return self.placed.attributes

    def points(
        self, guides: Float[np.ndarray, "g n 3"], body_vertices: Float[np.ndarray, "v 3"]
    ) -> Float32[np.ndarray, "p 3"]:
        """The strands of a frame one after another in the source's order, roots first [m, world].

        Args:
            guides: the groom's strands, draped or posed [m, world].
            body_vertices: of the body that they were draped on [m, world].

        Raises:
            InputError: strands of another groom.
        """
        rest = np.ascontiguousarray(self.groom.rest_strands.numpy(), dtype=np.float32)
        if guides.shape != rest.shape:
            raise InputError("guides", f"the {len(rest)} of {rest.shape[1]} vertices of the groom", f"{guides.shape}")
        # Writable, as most guides are: kernels are compiled anew for those that are not, such as a file's.
        draped = np.require(guides, np.float32, ("C", "W"))
        if not (np.isfinite(draped).all() and np.isfinite(body_vertices).all()):
            raise InputError("guides", "finite guides and body vertices", "NaN or infinity")
        # A copy: frames read from a file are not writable.
        vertices = torch.from_numpy(np.array(body_vertices, dtype=np.float32))
        surface = posed_surface(
            self.body.surface_topology, vertices[None], torch.from_numpy(draped[:, 0].mean(0))[None]
        )
        rotations = np.empty((len(rest), rest.shape[1] - 1, 3, 3), np.float32)
        guide_rotations(rest, draped, _turns(self.body.faces[self.groom.root_faces], vertices, self.body), rotations)
        carriers = torch.from_numpy(self.carriers).long()
        offset = np.einsum("sij,sj->si", triangle_frames(vertices[carriers]).numpy(), self.root_offset)
        roots = np.einsum("sc,scx->sx", self.root_weights, vertices[carriers].numpy()) + offset
        result = np.empty_like(self.placed.points)
        turns = _turns(carriers, vertices, self.body)
        drive_strands(self._driven, draped, rotations, roots, turns, surface.sample_arrays(0), result)
        return result

    @property
    def _driven(self) -> DrivenStrands:
        edge_length = self.guide_lengths / np.float32(self.groom.rest_strands.shape[1] - 1)
        strands = self.placed.points, self.placed.starts, self.placed.counts
        return DrivenStrands(*strands, self.guides, self.weights, self.own_guide, edge_length)


def place_strands(strands: Strands, report: RegistrationReport, body: BodyModel) -> PlacedStrands:
    """The strands of a source where their registration put them.

    Args:
        strands: as read.
        report: of their registration.
    """
    order = _order(strands.counts, report.from_tip)
    placed = (report.scale * strands.points.astype(np.float64) @ report.rotation.T + report.translation)[order]
    if not report.frame.registered:
        roots = placed[strands.starts]
        closest = nearest_on_scalp(torch.from_numpy(roots).float(), body)[2].double().numpy()
        placed += np.repeat(np.where(report.on_scalp[:, None], closest - roots, 0.0), strands.counts, axis=0)
    attributes = strands.attributes.scaled(report.scale).rearranged(order)
    return PlacedStrands(placed.astype(np.float32), strands.counts, report.from_tip, report.on_scalp, attributes)


def original_strands(placed: PlacedStrands, groom: Groom, body: BodyModel) -> OriginalStrands:
    """What drives the strands of a source.

    Args:
        groom: registered from the same source, all of it or the part that is draped; its rest drives the strands.
    """
    faces, weights, offset = _roots(placed, body)
    found = driving_guides(Strands(placed.points, placed.counts, "strands"), groom, placed.on_scalp)
    return OriginalStrands(
        guide_lengths=groom.strand_lengths.numpy().astype(np.float32),
        vertex_count=int(placed.counts.max()),
        placed=placed,
        guides=found.guides.astype(np.int32),
        weights=np.where(placed.on_scalp[:, None], found.shares, 0.0).astype(np.float32),
        own_guide=found.own,
        carriers=body.faces[faces].numpy().astype(np.int32),
        root_weights=weights.numpy().astype(np.float32),
        root_offset=offset.astype(np.float32),
        groom=groom,
        body=body,
    )


def _roots(
    placed: PlacedStrands, body: BodyModel
) -> tuple[Int[Tensor, " s"], Float[Tensor, "s 3"], Float[np.ndarray, "s 3"]]:
    """Face, barycentric coordinates and offset in the face's frame of every root; off the scalp, of any face."""
    roots = torch.from_numpy(placed.points[placed.starts])
    faces, weights, _ = nearest_on_scalp(roots, body)
    off = torch.from_numpy(np.flatnonzero(~placed.on_scalp))
    if len(off):
        found = closest_points(roots[off][None], body.rest_surface)
        faces[off], weights[off] = found.faces[0], found.barycentric[0]
    triangles = body.rest_vertices[body.faces[faces]]
    local = roots - (weights[..., None] * triangles).sum(1)
    return faces, weights, (triangle_frames(triangles).mT @ local[..., None])[..., 0].numpy()


def _turns(
    carriers: Int[Tensor, "n 3"], vertices: Float[Tensor, "v 3"], body: BodyModel
) -> Float32[np.ndarray, "n 3 3"]:
    """`triangle_rotations` for the kernels."""
    return np.ascontiguousarray(triangle_rotations(carriers, vertices, body).numpy(), dtype=np.float32)


def _order(counts: Int[np.ndarray, " s"], reverse: Bool[np.ndarray, " s"]) -> Int[np.ndarray, " p"]:
    """Indices of points that turn some of the strands round; its own inverse."""
    starts = np.cumsum(counts) - counts
    local = np.arange(counts.sum()) - np.repeat(starts, counts)
    turned = np.repeat(counts - 1, counts) - local
    return np.repeat(starts, counts) + np.where(np.repeat(reverse, counts), turned, local)
