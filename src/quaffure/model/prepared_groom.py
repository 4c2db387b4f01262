"""What a drape needs of a groom on a body, whatever the pose."""

from dataclasses import dataclass, fields

import torch

from quaffure.body.body_model import BodyModel
from quaffure.body.mls_body import mls_body
from quaffure.config import TEXTURE_SIZE, HairMaterial
from quaffure.energies.rest_state import RestState, rest_state
from quaffure.geometry.mls_surface import local_features
from quaffure.hair.groom import Groom
from quaffure.hair.strand_blocks import ClusteredBlocks, StrandBlocks, cluster_representatives, strand_blocks
from quaffure.model.groom_code import groom_code
from quaffure.model.inference_network import texel_rows
from quaffure.model.projection import clearance_of
from quaffure.model.quaffure_network import POSE_SIZE, SHAPE_SIZE, QuaffureNetwork
from quaffure.types import Float, Int, RestLengths, Tensor

THICKNESS, THICK_FROM = 0.03, 0.1
"""How far above the lowest hair the uppermost starts, and after which length of strand all of it [m]."""
ANY_DEPTH = -10.0
"""A margin that no strand falls short of [m]."""
TOLERATED, MOST_TOLERATED = 0.25, 0.004
"""How far below its clearance at rest hair may start: a share of the depth at which Eq. 10 pushes an edge of length l
as hard as the edge resists, k_Cosserat / (3 k_bc l^2), and at most so far [m]."""
SEEN = 0.05
"""From which amount of a view on it tells a distance."""


@dataclass(frozen=True, eq=False)
class PreparedGroom:
    """A groom on a body, made once for all poses.

    Attributes:
        code: of the frozen encoder.
        rest_length: of every edge [m].
        margin: see `initial_clearance`; for networks whose strands do not slide, below whatever is met [m].
        leader: the strand that feels the skin for each, see `quaffure.hair.strand_blocks.cluster_representatives`.
        clearance: distance at which hair is pushed out of the skin in the end [m], `quaffure.model.projection`.
    """

    code: Float[Tensor, "16"]
    rest_length: RestLengths
    margin: Float[Tensor, "s n"]
    leader: Int[Tensor, " s"]
    clearance: Float[Tensor, "s n"]


@dataclass(frozen=True, eq=False)
class PackedGroom(PreparedGroom):
    """The same laid out for the kernels: a row is a strand in the order of the packets.

    Attributes:
        texels: of every row, see `quaffure.model.inference_network.texel_rows`.
    """

    packets: ClusteredBlocks
    texels: Int[Tensor, " row"]

    @property
    def nbytes(self) -> int:
        """Memory that the kernels read of it."""
        strands = (self.packets, self.packets.leading)
        arrays = [getattr(packets, field.name) for packets in strands for field in fields(StrandBlocks)]
        own = (self.packets.leader, self.texels, self.rest_length, self.clearance)
        return sum(array.nbytes for array in (*arrays, *own))


def prepare_groom(groom: Groom, body: BodyModel, network: QuaffureNetwork, material: HairMaterial) -> PreparedGroom:
    """Fit a groom that is registered to `body`.

    Raises:
        InputError: it is not laid out for the network (`quaffure.model.groom_code`).
    """
    rest = rest_state(groom.rest_strands.detach(), material)
    margin = torch.full_like(rest.collision_margin, ANY_DEPTH)
    if network.config.slides:
        margin = initial_clearance(groom, rest, material, body)
    code = groom_code(groom, body, network.encoder)
    return PreparedGroom(code, rest.rest_length, margin, cluster_representatives(groom), clearance_of(rest))


def pack_groom(groom: Groom, body: BodyModel, fitted: PreparedGroom) -> PackedGroom:
    """Lay a fitted groom out for the kernels.

    Raises:
        InputError: a root that is not on the scalp.
    """
    packets = strand_blocks(groom, body, fitted.margin)
    strand = torch.from_numpy(packets.strand).flatten().long()
    texels = texel_rows(groom.texels()[strand], TEXTURE_SIZE)
    return PackedGroom(**vars(fitted), packets=packets, texels=texels)


def initial_clearance(groom: Groom, rest: RestState, material: HairMaterial, body: BodyModel) -> Float[Tensor, "s n"]:
    """Distance from the softened body that strands start with [m].

    Hair that roots higher lies on top: without it all hair would start in one layer, pressed to many times its density.
    Nothing has to be further out than it is at rest, where hair may lie closer to the head than a softened body is
    true, and stiff hair not even that: where the nape wrinkles, stubble, whose edges resist more than contact would
    push them, is not bent for some tenths of a millimetre.
    """
    height = groom.rest_strands[:, 0, 2].argsort().argsort() / len(groom)
    arc = torch.nn.functional.pad(rest.rest_length.cumsum(dim=1), (1, 0))
    layered = rest.collision_margin + THICKNESS * height[:, None] * (arc / THICK_FROM).clamp(max=1)
    at_rest = body.pose(arc.new_zeros(1, POSE_SIZE), arc.new_zeros(1, SHAPE_SIZE))
    surface = mls_body(body, at_rest)
    views = local_features(groom.rest_strands.flatten(0, 1)[None], surface).unflatten(1, layered.shape)[0]
    seen = views[..., 4]
    clearance = torch.where(seen > SEEN, surface.radius * views[..., 0] / seen.clamp(min=SEEN), torch.inf)
    balanced = material.k_cosserat / (3 * material.k_body_collision * rest.rest_length.mean(1, keepdim=True).square())
    return torch.minimum(layered, clearance - (TOLERATED * balanced).clamp(max=MOST_TOLERATED))
