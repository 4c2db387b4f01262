"""What a drape needs of a groom on a body, whatever the pose."""

from dataclasses import dataclass, fields

import torch

from quaffure.body.body_model import BodyModel
from quaffure.body.soft_body import soft_body
from quaffure.config import TEXTURE_SIZE, HairMaterial
from quaffure.drapers.projection import clearance_of
from quaffure.energies.rest_state import RestState, rest_state
from quaffure.geometry.soft_surface import soft_views
from quaffure.groom.groom import Groom
from quaffure.groom.strand_packets import LedPackets, StrandPackets, leader_of, strand_packets
from quaffure.networks.groom_code import groom_code
from quaffure.networks.inference_network import texel_rows
from quaffure.networks.quaffure_network import POSE_SIZE, SHAPE_SIZE, QuaffureNetwork
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
class FittedGroom:
    """A groom on a body, made once for all poses.

    Attributes:
        code: of the frozen encoder.
        rest_length: of every edge [m].
        margin: see `starting_margin`; for networks whose strands do not slide, below whatever is met [m].
        leader: the strand that feels the skin for each, see `quaffure.groom.strand_packets.leader_of`.
        clearance: distance at which hair is pushed out of the skin in the end [m], `quaffure.drapers.projection`.
    """

    code: Float[Tensor, "16"]
    rest_length: RestLengths
    margin: Float[Tensor, "s n"]
    leader: Int[Tensor, " s"]
    clearance: Float[Tensor, "s n"]


@dataclass(frozen=True, eq=False)
class PackedGroom(FittedGroom):
    """The same laid out for the kernels: a row is a strand in the order of the packets.

    Attributes:
        texels: of every row, see `quaffure.networks.inference_network.texel_rows`.
    """

    packets: LedPackets
    texels: Int[Tensor, " row"]

    @property
    def nbytes(self) -> int:
        """Memory that the kernels read of it."""
        strands = (self.packets, self.packets.leading)
        arrays = [getattr(packets, field.name) for packets in strands for field in fields(StrandPackets)]
        own = (self.packets.leader, self.texels, self.rest_length, self.clearance)
        return sum(array.nbytes for array in (*arrays, *own))


def fit_groom(groom: Groom, body: BodyModel, network: QuaffureNetwork, material: HairMaterial) -> FittedGroom:
    """Fit a groom that is registered to `body`.

    Raises:
        InputError: it is not laid out for the network (`quaffure.networks.groom_code`).
    """
    rest = rest_state(groom.rest_strands.detach(), material)
    margin = torch.full_like(rest.collision_margin, ANY_DEPTH)
    if network.config.slides:
        margin = starting_margin(groom, rest, material, body)
    code = groom_code(groom, body, network.encoder)
    return FittedGroom(code, rest.rest_length, margin, leader_of(groom), clearance_of(rest))


def pack_groom(groom: Groom, body: BodyModel, fitted: FittedGroom) -> PackedGroom:
    """Lay a fitted groom out for the kernels.

    Raises:
        InputError: a root that is not on the scalp.
    """
    packets = strand_packets(groom, body, fitted.margin)
    strand = torch.from_numpy(packets.strand).flatten().long()
    texels = texel_rows(groom.texels()[strand], TEXTURE_SIZE)
    return PackedGroom(**vars(fitted), packets=packets, texels=texels)


def starting_margin(groom: Groom, rest: RestState, material: HairMaterial, body: BodyModel) -> Float[Tensor, "s n"]:
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
    surface = soft_body(body, at_rest)
    views = soft_views(groom.rest_strands.flatten(0, 1)[None], surface).unflatten(1, layered.shape)[0]
    seen = views[..., 4]
    clearance = torch.where(seen > SEEN, surface.radius * views[..., 0] / seen.clamp(min=SEEN), torch.inf)
    balanced = material.k_cosserat / (3 * material.k_body_collision * rest.rest_length.mean(1, keepdim=True).square())
    return torch.minimum(layered, clearance - (TOLERATED * balanced).clamp(max=MOST_TOLERATED))
