"""Where strands are before the network: carried by the scalp, bent by their weight, slid along the softened body.

Sliding alone turns every edge by itself: hair over a shoulder would stand out from it like a cape, where the skin's
push turns the edges above as well. So strands slide twice: first to feel how hard the skin pushes, then for good. One
of a few neighbours feels for all of them.
"""

from typing import NamedTuple

import numpy as np
import torch
from numba import get_num_threads

from quaffure.body.body_model import BodyModel
from quaffure.body.head_frame import HeadFrameBody
from quaffure.config import STANDARD_GRAVITY, HairMaterial
from quaffure.energies.closed_form import equilibrium_vectors
from quaffure.energies.rest_state import rest_state
from quaffure.geometry.mls_surface import (
    LANES,
    LOCAL_FEATURES,
    SHORTEST,
    MlsPoints,
    MlsSurface,
    mls_points,
    resolve_contact_reference,
)
from quaffure.hair.groom import Groom
from quaffure.hair.posing import triangle_frames
from quaffure.hair.strand_blocks import ClusteredBlocks, StrandBlocks, scalp_corners
from quaffure.model.initial_shape_kernels import PROPAGATED_SHARE, SHARE, feel, grow
from quaffure.types import EdgeVectors, Float, Int, RestLengths, Tensor


class InitialShape(NamedTuple):
    """Strands before the network, in the head's frame and relative to the head joint.

    Attributes:
        roots: first vertices [m].
        edges: unit vectors.
        compliance: how far each edge turns [rad] when it is pushed as hard as the strand beyond it weighs, and a part
            of the whole strand (`SHARE`), and how far the skin has turned it already; one at most.
        told: what the network is told of each strand in its first 8 e columns: positions of all vertices but the root
            [m], then what each of them saw of the skin before its edge turned (`quaffure.geometry.mls_surface`).
    """

    roots: Float[Tensor, "b s 3"]
    edges: EdgeVectors
    compliance: Float[Tensor, "b s e"]
    told: Float[Tensor, "b s columns"]


def initial_shape_reference(
    groom: Groom,
    body: BodyModel,
    view: HeadFrameBody,
    material: HairMaterial,
    margin: Float[Tensor, "s n"],
    leader: Int[Tensor, " s"],
) -> InitialShape:
    """Torch twin of `initial_shape`, for any device.

    Args:
        margin: see `quaffure.model.prepared_groom.initial_clearance`.
        leader: see `quaffure.hair.strand_blocks.cluster_representatives`.

    Raises:
        InputError: a root that is not on the scalp.
    """
    rest = rest_state(groom.rest_strands, material)
    corners = scalp_corners(groom, body)
    carriers, weights = body.rest_vertices[body.faces[groom.root_faces]], groom.root_barycentric[..., None]
    posed = view.scalp[:, corners]
    rotation = triangle_frames(posed) @ triangle_frames(carriers).mT
    offset = groom.rest_strands[:, 0] - (weights * carriers).sum(-2)
    roots = (weights * posed).sum(-2) + (rotation @ offset[..., None])[..., 0]
    director = torch.nn.functional.normalize(groom.rest_strands.diff(dim=1), dim=-1) @ rotation.mT
    sag = equilibrium_vectors(
        director @ view.world_from_head[:, None].mT, rest.rest_length, rest.mass_beyond, material.k_cosserat
    )
    sag = sag @ view.world_from_head[:, None]
    edges, views = resolve_contact_twice(roots, sag, rest.rest_length, margin, view.surface, leader)
    turned = (edges - torch.nn.functional.normalize(sag, dim=-1)).norm(dim=-1)
    load = STANDARD_GRAVITY * (
        rest.mass_beyond + SHARE * material.linear_density * rest.rest_length.sum(1, keepdim=True)
    )
    compliance = (rest.rest_length * load / material.k_cosserat + turned).clamp(max=1)
    positions = roots[:, :, None] + (rest.rest_length[..., None] * edges).cumsum(dim=2)
    return InitialShape(roots, edges, compliance, torch.cat([positions.flatten(2), views.flatten(2)], dim=2))


def resolve_contact_twice(
    root: Float[Tensor, "b s 3"],
    vectors: EdgeVectors,
    rest_length: RestLengths,
    margin: Float[Tensor, "s n"],
    surface: MlsSurface,
    leader: Int[Tensor, " s"],
    share: float = PROPAGATED_SHARE,
) -> tuple[EdgeVectors, Float[Tensor, "b s e 5"]]:
    """`resolve_contact_reference`, once to feel the skin, then with a share of its push handed back to the edges above.

    Args:
        leader: the strand that feels for each.
    """
    leading, follow = leader.unique(return_inverse=True)
    chosen = (root[:, leading], vectors[:, leading], rest_length[leading], margin[leading])
    edges, seen = resolve_contact_reference(*chosen, surface)
    push = propagate_contact_force(vectors[:, leading], edges, seen[..., 1:4], rest_length[leading])[:, follow]
    return resolve_contact_reference(
        root, vectors + share * rest_length[..., None] * push, rest_length, margin, surface
    )


def propagate_contact_force(
    vectors: EdgeVectors, edges: EdgeVectors, normals: EdgeVectors, rest_length: RestLengths
) -> EdgeVectors:
    """Force with which the skin pushes each edge, by itself and through those beyond, over k_Cosserat [1/m].

    A force F on the end of an edge adds l F / k to its direction (`equilibrium_vectors`), and to what every edge
    above would. The skin only pushes: where those beyond are pushed harder than an edge needs, it pushes no more.

    Args:
        vectors: what edges would point along without the skin.
        edges: unit, turned by it.
        normals: of the skin at their ends, of any length.
    """
    length = rest_length[..., None].clamp(min=SHORTEST)
    strength = vectors.norm(dim=-1, keepdim=True)
    needed = (edges * strength - vectors) / length
    normals = torch.nn.functional.normalize(normals, dim=-1)
    total, totals = torch.zeros_like(vectors[:, :, 0]), []
    for edge in reversed(range(vectors.shape[2])):
        normal = normals[:, :, edge]
        own, others = ((force * normal).sum(-1, keepdim=True) for force in (needed[:, :, edge], total))
        total = total + (own - others.clamp(min=0)).clamp(min=0) * normal
        totals.append(total)
    return torch.stack(totals[::-1], dim=2)


def initial_shape(packets: ClusteredBlocks, view: HeadFrameBody, material: HairMaterial) -> InitialShape:
    """A groom on a batch of bodies before the network, in the order of its strands; float32, on the CPU."""
    batch, strands, edges = len(view.head), packets.strands, packets.edges.shape[1]
    start = InitialShape(
        torch.empty(batch, strands, 3),
        torch.empty(batch, strands, edges, 3),
        torch.empty(batch, strands, edges),
        torch.empty(batch, strands, (3 + LOCAL_FEATURES) * edges),
    )
    fill_initial_shape(packets, packets.strand, view, mls_points(view.surface), material, start)
    return start


def fill_initial_shape(
    packets: ClusteredBlocks,
    row_of: Int[np.ndarray, "packet lane"],
    view: HeadFrameBody,
    records: MlsPoints,
    material: HairMaterial,
    into: InitialShape,
) -> None:
    """Fill `into` with a groom before the network.

    Args:
        row_of: the row of `into` for the strand in each lane.
        into: its last field may be in bfloat16, and may have more columns.
    """
    weight, leading = material.linear_density * STANDARD_GRAVITY / material.k_cosserat, packets.leading
    common = (
        view.scalp.numpy(), -view.world_from_head[:, 2].numpy(), *records,
        np.float32(view.surface.radius), np.float32(weight), get_num_threads(),
    )  # fmt: skip
    push = np.empty((len(view.head), *leading.edges.shape[:2], 3 * LANES), np.float32)
    feel(*_strands(leading), *common, push)
    grow(
        *_strands(packets), *common, push, packets.leader, row_of,
        into.roots.numpy(), into.edges.numpy(), into.compliance.numpy(), bits(into.told),
    )  # fmt: skip


def _strands(packets: StrandBlocks) -> tuple[np.ndarray, ...]:
    """What both kernels read of strands first."""
    return packets.edges, packets.offset, packets.corners, packets.barycentric, packets.margin


def bits(values: Tensor) -> np.ndarray:
    """float32 or bfloat16 as the kernels take them: numpy knows no bfloat16."""
    if values.dtype == torch.bfloat16:
        return values.view(torch.int16).numpy().view(np.uint16)
    return values.numpy().view(np.uint32)
