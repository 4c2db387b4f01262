"""Initial shape of strands, before the network: posed, in equilibrium with gravity, and out of the point-sampled body.

Resolving contact alone deflects every edge by itself: hair over a shoulder would stand out from it like a cape, where
the skin's force deflects the edges above as well. So contact is resolved twice: first to estimate the skin's force on
the representative of each cluster of strands, then under a share of this force.
"""

from typing import NamedTuple

import numpy as np
import torch
from numba import get_num_threads

from quaffure.body.head_frame import HeadFrameBody
from quaffure.config import EDGES_PER_STRAND, STANDARD_GRAVITY, HairMaterial
from quaffure.energies.closed_form import equilibrium_vectors
from quaffure.geometry.mls_surface import (
    MIN_LENGTH,
    MlsSurface,
    resolve_contact_reference,
)
from quaffure.hair.posing import triangle_frames
from quaffure.hair.strand_blocks import RestStrands
from quaffure.model.initial_shape_kernels import BodyArrays, ShapeArrays, initial_shape_kernel
from quaffure.model.network_config import InitialShapeConfig
from quaffure.model.prepared_groom import KernelBlocks, PreparedGroom
from quaffure.types import EdgeVectors, Float, Int, RestLengths, Tensor


class InitialShape(NamedTuple):
    """Strands before the network, in the head's frame and relative to the head joint.

    Attributes:
        roots: first vertices [m].
        edges: unit vectors.
        compliance: rotation of each edge [rad] when it is pushed as hard as the strand beyond it weighs, and a share
            of the whole strand (`load_share`), plus the skin's deflection; one at most.
        features: of each strand in the first 8 e columns: positions of all vertices but the root [m], then the local
            features of each before contact (`quaffure.geometry.mls_surface`).
    """

    roots: Float[Tensor, "b s 3"]
    edges: EdgeVectors
    compliance: Float[Tensor, "b s e"]
    features: Float[Tensor, "b s columns"]


def initial_shape_reference(
    groom: PreparedGroom, body: HeadFrameBody, material: HairMaterial, config: InitialShapeConfig
) -> InitialShape:
    """Torch twin of `fill_initial_shape`: any device and type, differentiable in the bodies and in the material."""
    rest_length, (roots, posed_edges) = groom.rest_length, strands_in_head_frame(groom.strands, body)
    director = torch.nn.functional.normalize(posed_edges, dim=-1)
    whole = rest_length.sum(1, keepdim=True)
    beyond = whole - rest_length.cumsum(1) + 0.5 * rest_length
    free = equilibrium_vectors(
        director @ body.world_from_head[:, None].mT, rest_length, material.linear_density * beyond, material.k_cosserat
    )
    free = free @ body.world_from_head[:, None]
    edges, local = resolve_contact_twice(
        roots, free, rest_length, groom.margin, body.surface, groom.representative, config.propagated_share
    )
    deflection = (edges - torch.nn.functional.normalize(free, dim=-1)).norm(dim=-1)
    load = STANDARD_GRAVITY * material.linear_density * (beyond + config.load_share * whole)
    compliance = (rest_length * load / material.k_cosserat + deflection).clamp(max=1)
    positions = roots[:, :, None] + (rest_length[..., None] * edges).cumsum(dim=2)
    return InitialShape(roots, edges, compliance, torch.cat([positions.flatten(2), local.flatten(2)], dim=2))


def strands_in_head_frame(strands: RestStrands, body: HeadFrameBody) -> tuple[Float[Tensor, "b s 3"], EdgeVectors]:
    """Roots and edges of a groom that moves rigidly with its scalp triangles [m, head's frame]."""
    triangles = body.scalp[:, strands.corners]
    frames = triangle_frames(triangles)
    roots = (strands.barycentric[..., None] * triangles).sum(-2) + (frames @ strands.offset[..., None])[..., 0]
    return roots, strands.edges @ frames.mT


def resolve_contact_twice(
    root: Float[Tensor, "b s 3"],
    vectors: EdgeVectors,
    rest_length: RestLengths,
    margin: Float[Tensor, "s n"],
    surface: MlsSurface,
    representative: Int[Tensor, " s"],
    share: float,
) -> tuple[EdgeVectors, Float[Tensor, "b s e 5"]]:
    """`resolve_contact_reference`, once to estimate contact forces, then under a share of them.

    Args:
        representative: the strand whose force each strand takes.
    """
    chosen, of_strand = representative.unique(return_inverse=True)
    edges, local = resolve_contact_reference(
        root[:, chosen], vectors[:, chosen], rest_length[chosen], margin[chosen], surface
    )
    force = propagate_contact_force(vectors[:, chosen], edges, local[..., 1:4], rest_length[chosen])[:, of_strand]
    return resolve_contact_reference(
        root, vectors + share * rest_length[..., None] * force, rest_length, margin, surface
    )


def propagate_contact_force(
    vectors: EdgeVectors, edges: EdgeVectors, normals: EdgeVectors, rest_length: RestLengths
) -> EdgeVectors:
    """Force of the skin on each edge, by itself and through those beyond, over k_Cosserat [1/m].

    A force F on the end of an edge adds l F / k to its direction (`equilibrium_vectors`), and to that of every edge
    above. The skin only pushes: where those beyond are pushed harder than an edge needs, it pushes no more.

    Args:
        vectors: edge directions without contact.
        edges: unit, deflected by the skin.
        normals: of the skin at their ends, of any length.
    """
    length = rest_length[..., None].clamp(min=MIN_LENGTH)
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


def empty_shape(batch: int, strands: int, features: int, dtype: torch.dtype) -> InitialShape:
    """Memory for `fill_initial_shape`."""
    return InitialShape(
        torch.empty(batch, strands, 3),
        torch.empty(batch, strands, EDGES_PER_STRAND, 3),
        torch.empty(batch, strands, EDGES_PER_STRAND),
        torch.empty(batch, strands, features, dtype=dtype),
    )


def fill_initial_shape(
    blocks: KernelBlocks,
    row_of: Int[np.ndarray, "block lane"],
    body: HeadFrameBody,
    material: HairMaterial,
    config: InitialShapeConfig,
    shape: InitialShape,
) -> None:
    """Fill `shape` with a groom on a batch of bodies before the network; float32, on the CPU.

    Args:
        row_of: the row of `shape` for the strand in each lane.
        shape: filled; its features may be in bfloat16, and may have more columns.
    """
    points, normals, radius = body.surface
    weight = float(material.linear_density) * STANDARD_GRAVITY / float(material.k_cosserat)
    arrays = BodyArrays(
        body.scalp.numpy(),
        -body.world_from_head[:, 2].numpy(),
        points.flatten(1, 2).contiguous().numpy(),
        normals.flatten(1, 2).contiguous().numpy(),
        np.float32(radius),
        np.float32(1 / radius),
        np.float32(weight),
        np.float32(config.propagated_share),
        np.float32(config.load_share),
    )
    roots, edges, compliance, features = shape
    initial_shape_kernel(
        blocks.strands, blocks.representatives, blocks.representative, row_of, arrays, get_num_threads(),
        ShapeArrays(roots.numpy(), edges.numpy(), compliance.numpy(), bits(features)),
    )  # fmt: skip


def bits(values: Tensor) -> np.ndarray:
    """float32 or bfloat16 as the kernels take them: numpy has no bfloat16."""
    if values.itemsize == 2:
        return values.view(torch.int16).numpy().view(np.uint16)
    return values.numpy().view(np.uint32)
