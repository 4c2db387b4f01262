"""Guide interpolation: from guides, which are draped, to the tens of thousands of strands that are rendered.

The paper does not describe this step. A strand is a mean of the three guides around its root, relative to their roots,
added to its own root, which moves with its face of the body. Plain means would flatten curls of different phase, so
only the axes of the guides are blended (a quartic along the strand); the detail comes from the nearest guide alone.
The guides and their largest weights are fixed on the groom at rest: no strand jumps between guides. Where guides
diverge in a drape, at a shoulder, the weights of the further ones fade out smoothly.
"""

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Float32, Int, Int32
from numba import njit, prange
from torch import Tensor

from quaffure.body.body_model import BodyModel
from quaffure.body.pose_features import world_from_head
from quaffure.errors import InputError
from quaffure.geometry.rotation import shortest_arc
from quaffure.hair.drape_sequence import DrapeSequence
from quaffure.hair.groom import Groom
from quaffure.hair.guide_triangles import coherence, first_direction_vertex, sample_roots, triangulate
from quaffure.hair.posing import nearest_scalp_vertex, triangle_rotations
from quaffure.hair.registration import nearest_on_scalp
from quaffure.hair.strand_attributes import NONE, StrandAttributes
from quaffure.hair.strands import held_parts_of

AXIS_DEGREE = 4
"""Degree of the polynomial that is the axis of a strand; the remainder is curls and frizz."""
MOST_STRANDS = 1_000_000
SHOWN_STRANDS, SHOWN_IN_VIDEOS = 12_000, 6_000
"""Strands that pictures and videos show at least: fewer are drawn wide, and look like wires. A frame of a video takes
1.5 s of a core with 2,465 guides, 2.5 s with 6,000 strands and 4 s with 12,000."""
# A root off the scalp (the hull of the guides can be wider) is moved half the way to its nearest guide, this often.
HALVINGS = 4
# Where guides are further apart than this [m], their shapes may differ more before they count as diverged, up to a
# factor: strands would copy the nearest guide alone, and stand in slabs.
DENSE_SPACING, MOST_SLACK = 0.015, 2.0
FARTHEST_ROOT = 2e-3  # m: a drape's roots lie on its body


@dataclass(frozen=True)
class GuideInterpolation:
    """Strands between guides.

    Attributes:
        guides: three guides of every strand, the nearest first.
        weights: share of each in the strand's axis at rest; they sum to 1.
        carriers: body vertices of the root's face.
        root_weights: barycentric coordinates of the root among them.
        guide_lengths: to which distances between guides are compared: theirs at rest, times `spacing_slack` [m].
        vertex_count: of a guide and of a strand.
    """

    guides: Int32[np.ndarray, "m 3"]
    weights: Float32[np.ndarray, "m 3"]
    carriers: Int32[np.ndarray, "m 3"]
    root_weights: Float32[np.ndarray, "m 3"]
    guide_lengths: Float32[np.ndarray, " s"]
    vertex_count: int

    def __len__(self) -> int:
        """Number of strands."""
        return len(self.guides)

    @property
    def counts(self) -> Int[np.ndarray, " m"]:
        """Vertices of every strand, where they are not resampled."""
        return np.full(len(self), self.vertex_count)

    @property
    def attributes(self) -> StrandAttributes:
        """What is known of the strands besides; widths [m]."""
        return NONE

    def points(
        self, guides: Float32[np.ndarray, "s n 3"], body_vertices: Float32[np.ndarray, "v 3"]
    ) -> Float32[np.ndarray, "p 3"]:
        """Vertices of all strands one after another, as many of each as `counts` says, roots first [m, world].

        Args:
            guides, body_vertices: as of `strands`.
        """
        return self.strands(guides, body_vertices).reshape(-1, 3)

    def strands(
        self,
        guides: Float32[np.ndarray, "s n 3"],
        body_vertices: Float32[np.ndarray, "v 3"],
        out: Float32[np.ndarray, "m n 3"] | None = None,
    ) -> Float32[np.ndarray, "m n 3"]:
        """Strands between the posed or draped guides of one frame [m, world].

        Args:
            guides: roots first [m, world].
            body_vertices: the body that they were draped on [m, world].
            out: array for the result, if available.

        Raises:
            InputError: guides of another groom.
        """
        if guides.shape != (len(self.guide_lengths), self.vertex_count, 3):
            raise InputError("guides", f"{len(self.guide_lengths)} of {self.vertex_count} vertices", f"{guides.shape}")
        if out is None:
            out = np.empty((len(self), self.vertex_count, 3), np.float32)
        # Writable, as most arrays are: kernels are compiled anew for those that are not, such as a file's.
        guides, body_vertices = (np.require(array, requirements=("C", "W")) for array in (guides, body_vertices))
        axes, detail = np.empty_like(guides), np.empty_like(guides)
        _split(guides, axis_projection(self.vertex_count), axes, detail)
        mixture = _Mixture(self.guides, self.weights, self.guide_lengths, self.carriers, self.root_weights)
        _mix(axes, detail, mixture, body_vertices, first_direction_vertex(self.vertex_count), out)
        return out


def interpolation_of(groom: Groom, body: BodyModel, count: int, seed: int = 0) -> GuideInterpolation:
    """Roots for `count` strands on the part of the scalp that the guides cover, and the guides of each.

    Guides that diverge at rest from the nearest one (across a parting, around an ear) have no weight.

    Args:
        groom: the guides.
        body: that the groom is registered to.

    Raises:
        InputError: fewer strands than one or more than a million, or too few guides to have strands between them.
    """
    if not 1 <= count <= MOST_STRANDS:
        raise InputError("strands", f"1 to {MOST_STRANDS}", f"{count}")
    rest, uv = groom.rest_strands.numpy(), groom.root_uv.numpy()
    triangles = triangulate(uv, rest[:, 0], groom.name)
    triangle, shares = sample_roots(triangles, rest[:, 0], count, seed)
    guides = triangles[triangle]
    order = np.argsort(-shares, axis=1, kind="stable")
    guides, shares = np.take_along_axis(guides, order, 1), np.take_along_axis(shares, order, 1)
    faces, root_weights = _roots(groom, body, guides, shares)
    axes = axis_projection(rest.shape[1]) @ (rest - rest[:, :1])
    lengths = spacing_slack(triangles, rest[:, 0]) * groom.strand_lengths.numpy()
    shares[:, 1:] *= _coherences(axes, lengths, guides, first_direction_vertex(rest.shape[1]))
    weights = shares / shares.sum(axis=1, keepdims=True)
    return GuideInterpolation(
        guides=guides.astype(np.int32),
        weights=weights.astype(np.float32),
        carriers=body.faces[faces].numpy().astype(np.int32),
        root_weights=root_weights.numpy(),
        guide_lengths=lengths,
        vertex_count=rest.shape[1],
    )


def shown_between(groom: Groom, body: BodyModel, in_video: bool = False) -> GuideInterpolation | None:
    """Strands for a picture of guides, or for a video, that are fewer than it shows; None where the guides are as many,
    or too few to have strands between them."""
    count = SHOWN_IN_VIDEOS if in_video else SHOWN_STRANDS
    if len(groom) >= count:
        return None
    try:
        return interpolation_of(groom, body, count)
    except InputError:
        return None


def spacing_slack(triangles: Int[np.ndarray, "t 3"], roots: Float[np.ndarray, "s 3"]) -> np.float32:
    """Factor by which guides may diverge more: 1 of dense guides, 2 of guides that are 30 mm apart [-].

    Args:
        triangles: of guides that are neighbours.
        roots: of the guides [m].
    """
    spacing = np.median(np.linalg.norm(roots[triangles] - roots[np.roll(triangles, 1, axis=1)], axis=-1))
    return np.float32(np.clip(spacing / DENSE_SPACING, 1.0, MOST_SLACK))


def _roots(
    groom: Groom, body: BodyModel, guides: Int[np.ndarray, "m 3"], shares: Float[np.ndarray, "m 3"]
) -> tuple[Int[Tensor, " m"], Float[Tensor, "m 3"]]:
    """Body faces and barycentric coordinates of roots between guides; those off the scalp move to their first guide."""
    uv = (torch.from_numpy(shares)[..., None] * groom.root_uv[guides]).sum(1).float()
    nearest = torch.from_numpy(guides[:, 0]).long()
    faces, weights = body.scalp.locate(uv)
    for _ in range(HALVINGS):
        off = faces < 0
        uv[off] = 0.5 * (uv[off] + groom.root_uv[nearest[off]])
        faces[off], weights[off] = body.scalp.locate(uv[off])
    off = faces < 0
    faces[off], weights[off] = groom.root_faces[nearest[off]], groom.root_barycentric[nearest[off]]
    return faces, weights


@cache
def axis_projection(vertices: int) -> Float32[np.ndarray, "n n"]:
    """Matrix from a strand relative to its root to its axis: the best-fit polynomial through the root."""
    basis = np.linspace(0, 1, vertices)[:, None] ** np.arange(1, min(AXIS_DEGREE, vertices - 1) + 1)
    return (basis @ np.linalg.pinv(basis)).astype(np.float32)


def groom_of_drape(sequence: DrapeSequence, body: BodyModel, source: str | Path = "drape") -> Groom:
    """The groom at rest of a drape, recovered from the first of its posed frames.

    Args:
        source: its file, for errors.

    Raises:
        InputError: the drape's body is not `body`, or its roots are not on the scalp.
    """
    if not np.array_equal(sequence.body_faces, body.faces.numpy()):
        file = sequence.meta.get("body") or "my_body.npz"
        expected = f"a drape on the {'shipped' if body.origin is None else 'given'} body"
        raise InputError(source, expected, f"another body; give the drape's own, as in --body {file}")
    sequence = sequence.in_place()
    posed, vertices = torch.from_numpy(sequence.posed[0]), torch.from_numpy(sequence.body_vertices[0])
    faces, weights, closest = nearest_on_scalp(posed[:, 0], replace(body, rest_vertices=vertices))
    apart = float((closest - posed[:, 0]).norm(dim=-1).max())
    if apart > FARTHEST_ROOT:
        raise InputError(source, f"roots within {1e3 * FARTHEST_ROOT:g} mm of the scalp", f"{1e3 * apart:.1f} mm")
    carriers = body.faces[faces]
    rest_from_world = triangle_rotations(carriers, vertices, body).mT
    roots = (weights[..., None] * body.rest_vertices[carriers]).sum(-2)
    held_parts = {name: torch.from_numpy(values) for name, values in held_parts_of(sequence).items()}
    if "tie_vertex" in held_parts:
        tied, rotation = _tied_rest_from_world(sequence, body, held_parts["tie_vertex"].long(), roots)
        rest_from_world[tied] = rotation
    rest = (posed - posed[:, :1]) @ rest_from_world.mT + roots[:, None]
    name, licence = (str(sequence.meta.get(key, "")) for key in ("groom", "licence"))
    return Groom(name or "drape", rest, faces, weights, body.scalp.uv_at(faces, weights), licence, **held_parts)


def _tied_rest_from_world(
    sequence: DrapeSequence, body: BodyModel, tie_vertex: Int[Tensor, " s"], rest_roots: Float[Tensor, "s 3"]
) -> tuple[Int[Tensor, " t"], Float[Tensor, "t 3 3"]]:
    """The tied strands and their rotation back from the first posed frame: `Ties.rotation` undone.

    Known are the unit vector p from root to tie in the pose and how far root and tie have moved apart, m; the rest
    vector d between them is as long as in the pose, and d + m points along p.
    """
    tied = (tie_vertex > 0).nonzero()[:, 0]
    posed, vertices = torch.from_numpy(sequence.posed[0])[tied], torch.from_numpy(sequence.body_vertices[0])
    pose, shape = torch.from_numpy(sequence.body_pose[:1]), torch.from_numpy(sequence.body_shape)[None]
    head = world_from_head(body, body.posed_joints(pose, shape)[0])[0]
    tie = posed[torch.arange(len(tied)), tie_vertex[tied]]
    anchor = nearest_scalp_vertex(tie, vertices, body)
    between = (tie - posed[:, 0]) @ head
    length = between.norm(dim=-1, keepdim=True)
    along = between / length
    moved = (vertices[anchor] - posed[:, 0]) @ head - (body.rest_vertices[anchor] - rest_roots[tied])
    share = (along * moved).sum(-1, keepdim=True)
    at_rest = (
        share + (share**2 + length**2 - moved.square().sum(-1, keepdim=True)).clamp(min=0).sqrt()
    ) * along - moved
    turned = shortest_arc(torch.nn.functional.normalize(at_rest, dim=-1), along)
    return tied, turned.mT @ head.mT


@njit(cache=True, parallel=True, fastmath=True)
def _split(guides: np.ndarray, projection: np.ndarray, axes: np.ndarray, detail: np.ndarray) -> None:
    """Axis of every guide, relative to its root, and the remaining detail."""
    strands, count, _ = guides.shape
    for strand in prange(strands):
        for vertex in range(count):
            for axis in range(3):
                total = np.float32(0.0)
                for other in range(count):
                    total += projection[vertex, other] * (guides[strand, other, axis] - guides[strand, 0, axis])
                axes[strand, vertex, axis] = total
                detail[strand, vertex, axis] = guides[strand, vertex, axis] - guides[strand, 0, axis] - total


class _Mixture(NamedTuple):
    """Fields of `GuideInterpolation`, as the kernel reads them."""

    guides: np.ndarray
    weights: np.ndarray
    lengths: np.ndarray
    carriers: np.ndarray
    root_weights: np.ndarray


@njit(cache=True, parallel=True, fastmath=True)
def _mix(
    axes: np.ndarray, detail: np.ndarray, mixture: _Mixture, body_vertices: np.ndarray, first: int, strands: np.ndarray
) -> None:
    guides, weights, lengths, carriers, root_weights = mixture
    count = strands.shape[1]
    for strand in prange(len(strands)):
        a, b, c = guides[strand]
        share_b = weights[strand, 1] * coherence(axes[a], axes[b], lengths[a] + lengths[b], first)
        share_c = weights[strand, 2] * coherence(axes[a], axes[c], lengths[a] + lengths[c], first)
        total = weights[strand, 0] + share_b + share_c
        share_b, share_c = share_b / total, share_c / total
        for axis in range(3):
            root = np.float32(0.0)
            for corner in range(3):
                root += root_weights[strand, corner] * body_vertices[carriers[strand, corner], axis]
            for vertex in range(count):
                nearest = axes[a, vertex, axis]
                strands[strand, vertex, axis] = (
                    root
                    + nearest
                    + share_b * (axes[b, vertex, axis] - nearest)
                    + share_c * (axes[c, vertex, axis] - nearest)
                    + detail[a, vertex, axis]
                )


@njit(cache=True)
def _coherences(axes: np.ndarray, lengths: np.ndarray, guides: np.ndarray, first: int) -> np.ndarray:
    """`coherence` of each strand's first guide with its two others."""
    found = np.empty((len(guides), 2), np.float32)
    for strand, (a, b, c) in enumerate(guides):
        found[strand, 0] = coherence(axes[a], axes[b], lengths[a] + lengths[b], first)
        found[strand, 1] = coherence(axes[a], axes[c], lengths[a] + lengths[c], first)
    return found
