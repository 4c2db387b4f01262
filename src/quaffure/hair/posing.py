"""Pose-based groom transform, Sec. 3.3: every strand moves rigidly with its scalp triangle.

A tied strand turns with the head instead, and points from its root to its tie. With their own triangles, strands would
arrive at their tie up to 8 cm apart in poses where the skin of the nape turns against the crown.
"""

from typing import NamedTuple

import torch

from quaffure.body.body_model import BodyModel, PosedBody
from quaffure.body.head_frame import scalp_vertices
from quaffure.body.pose_features import world_from_head
from quaffure.errors import InputError
from quaffure.geometry.rotation import shortest_arc
from quaffure.hair.groom import Groom
from quaffure.types import Float, Int, MeshVertices, Positions, Tensor

OWN_ROOT_DISTANCE = 0.02
"""Median distance of strands from their roots below which a groom stands on a body [m]."""


class Ties(NamedTuple):
    """Ties of a groom at rest. A tie keeps its place, in the head's frame, relative to the scalp vertex nearest to it.

    Attributes:
        strands: which ones are tied.
        anchor: body vertex nearest to the tie of each.
        offset: of the tie from that vertex [m].
        direction: unit vector from the root to the tie.
    """

    strands: Int[Tensor, " t"]
    anchor: Int[Tensor, " t"]
    offset: Float[Tensor, "t 3"]
    direction: Float[Tensor, "t 3"]

    def rotation(self, reach: Float[Tensor, "b t 3"]) -> Float[Tensor, "b t 3 3"]:
        """Rotation of every tied strand from rest, in the head's frame: the smallest that points it to its tie.

        Args:
            reach: from each root to the anchor of its tie [m, head's frame].
        """
        return shortest_arc(self.direction, torch.nn.functional.normalize(reach + self.offset, dim=-1))


def ties_of(groom: Groom, body: BodyModel) -> Ties:
    """The ties of a groom that is registered to `body`."""
    tie_vertex = torch.zeros_like(groom.root_faces) if groom.tie_vertex is None else groom.tie_vertex.long()
    strands = (tie_vertex > 0).nonzero()[:, 0]
    tie = groom.rest_strands[strands, tie_vertex[strands]]
    anchor = nearest_scalp_vertex(tie, body.rest_vertices, body)
    direction = torch.nn.functional.normalize(tie - rest_roots(groom, body)[strands], dim=-1)
    return Ties(strands, anchor, tie - body.rest_vertices[anchor], direction)


def nearest_scalp_vertex(
    points: Float[Tensor, "t 3"], vertices: Float[Tensor, "v 3"], body: BodyModel
) -> Int[Tensor, " t"]:
    """Body vertex of the scalp that is nearest to each point.

    Args:
        vertices: of the body, at rest or posed [m].
    """
    scalp = scalp_vertices(body)
    return scalp[torch.cdist(points, vertices[scalp]).argmin(dim=1)]


def triangle_frames(triangles: Float[Tensor, "*n 3 3"]) -> Float[Tensor, "*n 3 3"]:
    """Right-handed orthonormal frames of triangles, columns: first edge, in-plane normal to it, outward normal."""
    first, second, third = triangles.unbind(-2)
    along = torch.nn.functional.normalize(second - first, dim=-1)
    normal = torch.nn.functional.normalize(torch.linalg.cross(second - first, third - first), dim=-1)
    return torch.stack([along, torch.linalg.cross(normal, along), normal], dim=-1)


def root_positions(groom: Groom, vertices: MeshVertices, body: BodyModel) -> Float[Tensor, "b s 3"]:
    """Positions of the roots on posed bodies [m]."""
    triangles = vertices[:, body.faces[groom.root_faces]]
    return (groom.root_barycentric[..., None] * triangles).sum(-2)


def rest_roots(groom: Groom, body: BodyModel) -> Float[Tensor, "s 3"]:
    """Positions of the roots on the body at rest [m]."""
    return root_positions(groom, body.rest_vertices[None], body)[0]


def check_roots(groom: Groom, body: BodyModel) -> None:
    """Refuse a groom that stands on another body, whose faces have other places.

    Raises:
        InputError: a root that is not on the scalp, or roots that strands do not begin at.
    """
    found = "roots elsewhere"
    if bool(torch.isin(groom.root_faces, body.scalp.faces).all()):
        apart = (groom.rest_strands[:, 0] - rest_roots(groom, body)).norm(dim=-1).median()
        if float(apart) < OWN_ROOT_DISTANCE:
            return
        found = f"strands that begin {100 * float(apart):.1f} cm from theirs"
    expected = "roots on the scalp of the body that it is draped on"
    calls = "as a groom of another body has: load_groom(name, body) and load_model().on(body) take the same one"
    raise InputError(groom.name, expected, f"{found}, {calls}")


def rest_frames(groom: Groom, body: BodyModel, ties: Ties) -> Float[Tensor, "s 3 3"]:
    """Frame in which every strand moves rigidly: of its scalp triangle, of a tied strand the head's (the identity)."""
    frames = triangle_frames(body.rest_vertices[body.faces[groom.root_faces]])
    return frames.index_copy(0, ties.strands, torch.eye(3).to(frames).expand(len(ties.strands), 3, 3))


def triangle_rotations(
    corners: Int[Tensor, "n 3"], vertices: Float[Tensor, "v 3"], body: BodyModel
) -> Float[Tensor, "n 3 3"]:
    """Rotation of triangles of the body from rest to posed vertices."""
    return triangle_frames(vertices[corners]) @ triangle_frames(body.rest_vertices[corners]).mT


def posed_frames(
    triangles: Float[Tensor, "b s 3 3"],
    barycentric: Float[Tensor, "s 3"],
    anchors: Float[Tensor, "b t 3"],
    ties: Ties,
    head: Float[Tensor, "b 3 3"] | None = None,
) -> tuple[Float[Tensor, "b s 3"], Float[Tensor, "b s 3 3"]]:
    """What a posed body moves strands with: positions on their scalp triangles [m], and frames (`rest_frames` at rest).

    Args:
        triangles: scalp triangle of every strand [m].
        barycentric: position on it.
        anchors: of the ties [m].
        head: world_from_head, where all these are in the world; without it they are in the head's frame.
    """
    roots = (barycentric[..., None] * triangles).sum(-2)
    reach = anchors - roots[:, ties.strands]
    if head is None:
        tied = ties.rotation(reach)
    else:
        tied = head[:, None] @ ties.rotation((reach[:, :, None] @ head[:, None])[:, :, 0])
    return roots, triangle_frames(triangles).index_copy(1, ties.strands, tied)


def root_rotations(groom: Groom, posed: PosedBody, body: BodyModel) -> Float[Tensor, "b s 3 3"]:
    """Rotation of every strand from the rest body to the posed body (world_from_rest)."""
    ties, head = ties_of(groom, body), world_from_head(body, posed.joint_rotations)
    triangles, anchors = posed.vertices[:, body.faces[groom.root_faces]], posed.vertices[:, ties.anchor]
    _, frames = posed_frames(triangles, groom.root_barycentric, anchors, ties, head)
    return frames @ rest_frames(groom, body, ties).mT


def rigid_rotations(groom: Groom, posed: Positions) -> Float[Tensor, "b s 3 3"]:
    """Rotation of every strand from rest to a rigidly posed strand, fitted (Kabsch).

    The rotation of a straight strand about itself is not determined.
    """
    edges = groom.rest_strands.diff(dim=1).to(posed)
    u, _, vh = torch.linalg.svd(torch.einsum("bsni,snj->bsij", posed.diff(dim=2), edges))
    sign = torch.ones_like(u[..., 0])
    sign[..., 2] = torch.linalg.det(u @ vh).sign()
    return (u * sign[..., None, :]) @ vh


def posed_strands(
    groom: Groom, posed: PosedBody, body: BodyModel, rotation: Float[Tensor, "b s 3 3"] | None = None
) -> Positions:
    """The groom moved rigidly, strand by strand, with its scalp (x_posed) [m, world].

    Args:
        groom: registered to `body`.
        posed: a batch of poses and shapes of `body`.
        rotation: `root_rotations` of the same, where they are known already.
    """
    offsets = groom.rest_strands - rest_roots(groom, body)[:, None]
    rotation = root_rotations(groom, posed, body) if rotation is None else rotation
    return offsets @ rotation.mT + root_positions(groom, posed.vertices, body)[:, :, None]
