"""Initial shape of strands, before the network: posed, in equilibrium without contact, out of the point-sampled body.

Of the forces of the body that support the design, each is kept as far as it still points up: the one on hair that lies
on the crown is gone when the head is upside down, and upright the design is at rest. All of it is a smooth function of
the pose, so that hair draped frame by frame moves as smoothly as the network does.
"""

from typing import NamedTuple

import numpy as np
import torch
from numba import get_num_threads

from quaffure.body.head_frame import HeadFrameBody
from quaffure.config import EDGES_PER_STRAND
from quaffure.energies.loading import Loading
from quaffure.geometry.mls_surface import resolve_contact_reference
from quaffure.hair.posing import posed_frames
from quaffure.hair.strand_blocks import RestStrands
from quaffure.model.bend_relaxation import relaxed_edges
from quaffure.model.free_rod import FreeRods, free_rod_directions
from quaffure.model.initial_shape_kernels import BodyArrays, ShapeArrays, initial_shape_kernel
from quaffure.model.network_config import InitialShapeConfig
from quaffure.model.prepared_groom import KernelBlocks, PreparedGroom
from quaffure.types import EdgeVectors, Float, Int, Tensor


class InitialShape(NamedTuple):
    """Strands before the network, in the head's frame and relative to the head joint.

    Attributes:
        roots: first vertices [m].
        edges: unit vectors.
        compliance: rotation of each joint under the loads of now (`DesignRods`) [rad], plus that by which the skin has
            deflected the edge after it more than the one before; one at most, and none where a strand rests in its
            design, which the network leaves as it is.
        features: of each strand in the first 8 e columns: positions of all vertices but the root [m], then the local
            features of each before contact (`quaffure.geometry.mls_surface`).
    """

    roots: Float[Tensor, "b s 3"]
    edges: EdgeVectors
    compliance: Float[Tensor, "b s e"]
    features: Float[Tensor, "b s columns"]


def initial_shape_reference(
    groom: PreparedGroom, body: HeadFrameBody, loading: Loading, config: InitialShapeConfig
) -> InitialShape:
    """Torch twin of `fill_initial_shape`: any device and type, differentiable in the bodies.

    Args:
        loading: with one stiffness for all; one for each edge is in the groom (`PreparedGroom.stiffened`).
    """
    rest_length, rods = groom.rest_length, groom.rods
    roots, frames = strand_frames(groom.strands, body)
    if not isinstance(loading.stiffness, Tensor):
        rods = rods.stiffened(loading.stiffness)
    posed = torch.nn.functional.normalize(groom.strands.edges @ frames.mT, dim=-1)
    pull = roots.new_tensor(loading.in_gravities) @ body.world_from_head
    size = pull.norm(dim=-1)[:, None, None]
    support = rods.support @ frames.mT
    up = -pull[:, None, None] / size[..., None].clamp(min=1e-12)
    upness = 1 + (torch.nn.functional.normalize(support, dim=-1) * up).sum(-1)
    kept = size * (upness / rods.upness).clamp(max=1)
    free = free_rod_directions(
        FreeRods(
            posed,
            rods.moment @ frames.mT,
            rods.mass[..., None] * pull[:, None, None] + kept[..., None] * support,
            *(values.expand(len(roots), -1, -1) for values in (rods.bending, rods.goal, rest_length)),
        ),
        config.passes,
    )
    clearance = groom.initial_clearance
    edges, local = resolve_contact_reference(roots, free, rest_length, clearance, body.surface, config.decay_length)
    shape = edges
    if config.bend_relaxation > 0:
        shape = relaxed_edges(edges, free, rods.bending, rods.bending / config.bend_relaxation + rods.goal)
    deflection = torch.nn.functional.pad(edges - free, (0, 0, 1, 0)).diff(dim=2).norm(dim=-1)
    disturbance = (edges - posed).square().sum(-1).amax(dim=2, keepdim=True)
    fading = disturbance / (disturbance + config.least_disturbance**2 + 1e-12)
    tied = groom.strands.ties.strands
    fading = fading.index_copy(1, tied, config.tied_share * fading[:, tied])
    compliance = fading * (rods.compliance * size + deflection).clamp(max=1)
    positions = roots[:, :, None] + (rest_length[..., None] * shape).cumsum(dim=2)
    return InitialShape(roots, shape, compliance, torch.cat([positions.flatten(2), local.flatten(2)], dim=2))


def strand_frames(strands: RestStrands, body: HeadFrameBody) -> tuple[Float[Tensor, "b s 3"], Float[Tensor, "b s 3 3"]]:
    """First vertices [m, head's frame] of a posed groom and the frames of its strands (`RestStrands`)."""
    scalp, ties = body.scalp, strands.ties
    roots, frames = posed_frames(scalp[:, strands.corners], strands.barycentric, scalp[:, ties.anchor], ties)
    return roots + (frames @ strands.offset[..., None])[..., 0], frames


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
    loading: Loading,
    config: InitialShapeConfig,
    shape: InitialShape,
) -> None:
    """Fill `shape` with a groom on a batch of bodies before the network; float32, on the CPU.

    Args:
        row_of: the row of `shape` for the strand in each lane.
        loading: with one stiffness for all; one for each edge is in the blocks (`PreparedGroom.stiffened`).
        shape: filled; its features may be in bfloat16, and may have more columns.
    """
    points, normals, radius = body.surface
    pull = torch.tensor(loading.in_gravities) @ body.world_from_head
    arrays = BodyArrays(
        body.scalp.numpy(),
        pull.numpy(),
        points.flatten(1, 2).contiguous().numpy(),
        normals.flatten(1, 2).contiguous().numpy(),
        np.float32(radius),
        np.float32(1 / radius),
        np.float32(1.0 if isinstance(loading.stiffness, Tensor) else loading.stiffness),
        np.float32(config.least_disturbance**2 + 1e-12),
        np.float32(config.decay_length),
        np.float32(config.tied_share),
        np.float32(config.bend_relaxation),
    )
    roots, edges, compliance, features = shape
    initial_shape_kernel(
        blocks.strands, blocks.rods, row_of, arrays, config.passes, get_num_threads(),
        ShapeArrays(roots.numpy(), edges.numpy(), compliance.numpy(), bits(features)),
    )  # fmt: skip


def bits(values: Tensor) -> np.ndarray:
    """float32 or bfloat16 as the kernels take them: numpy has no bfloat16."""
    if values.itemsize == 2:
        return values.view(torch.int16).numpy().view(np.uint16)
    return values.numpy().view(np.uint32)
