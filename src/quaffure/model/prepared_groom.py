"""What a drape reads of a groom on a body, whatever the pose."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import torch

from quaffure.body.body_model import BodyModel
from quaffure.body.mls_body import mls_body
from quaffure.config import TEXTURE_SIZE, HairMaterial
from quaffure.energies.rest_state import RestState, rest_state
from quaffure.geometry.mls_surface import local_features
from quaffure.hair.groom import Groom
from quaffure.hair.strand_blocks import RestStrands, StrandBlocks, cluster_representatives, rest_strands, strand_blocks
from quaffure.model.groom_code import groom_code
from quaffure.model.groom_encoder import GroomEncoder
from quaffure.model.inference_network import StrandTexels, texture_rows
from quaffure.model.network_config import POSE_SIZE, SHAPE_SIZE, InitialShapeConfig, NetworkConfig
from quaffure.types import Float, Int, RestLengths, Tensor

NO_CONTACT = -10.0
"""A margin that is kept everywhere [m]."""


class KernelBlocks(NamedTuple):
    """A groom as the compiled kernels read it; a row is a lane of a block.

    Attributes:
        strands: all strands.
        representatives: those of the clusters alone.
        representative: lane in `representatives` of the one of each strand.
        rows: of the kernels' results, for each strand.
        texels: of each row.
    """

    strands: StrandBlocks
    representatives: StrandBlocks
    representative: Int[np.ndarray, "block lane"]
    rows: Int[np.ndarray, "block lane"]
    texels: StrandTexels

    @property
    def nbytes(self) -> int:
        """Memory that the kernels read [bytes]."""
        arrays = (*self.strands, *self.representatives, self.representative, self.texels.rows)
        return sum(array.nbytes for array in arrays)


@dataclass(frozen=True, eq=False)
class PreparedGroom:
    """A groom on a body, prepared once for all poses.

    Attributes:
        code: of the frozen encoder.
        texels: flat index of each strand's texel.
        strands: in the frames of their scalp triangles.
        rest_length: of every edge [m].
        margin: distance from the point-sampled body at which strands start, see `initial_clearance` [m].
        clearance: distance up to which hair is projected out of the skin [m], see `quaffure.model.projection`.
        order: of the strands in the kernels' blocks, clusters one after another.
        representative: the strand whose contact force each strand takes.
    """

    code: Float[Tensor, "16"]
    texels: Int[Tensor, " s"]
    strands: RestStrands
    rest_length: RestLengths
    margin: Float[Tensor, "s n"]
    clearance: Float[Tensor, "s n"]
    order: Int[Tensor, " s"]
    representative: Int[Tensor, " s"]

    @cached_property
    def blocks(self) -> KernelBlocks:
        """Laid out for the compiled kernels; float32, on the CPU."""
        strands = strand_blocks(self.strands, self.margin, self.order)
        chosen = self.order[self.representative[self.order] == self.order]
        lane_of = torch.empty_like(self.order)
        lane_of[chosen] = torch.arange(len(chosen))
        of_rows = torch.from_numpy(strands.strand).flatten().long()
        texels = StrandTexels(self.texels[of_rows], texture_rows(self.texels[of_rows], TEXTURE_SIZE))
        representatives = strand_blocks(self.strands, self.margin, chosen)
        # Lanes of the strands' own blocks, so that repeated strands at the end have a representative too.
        lanes = lane_of[self.representative[of_rows]].int().view(-1, strands.strand.shape[1]).numpy()
        rows = np.arange(strands.strand.size, dtype=np.int32).reshape(strands.strand.shape)
        return KernelBlocks(strands, representatives, np.ascontiguousarray(lanes), rows, texels)


def prepare_groom(
    groom: Groom, body: BodyModel, encoder: GroomEncoder, config: NetworkConfig, material: HairMaterial
) -> PreparedGroom:
    """Prepare a groom that is registered to `body`.

    Raises:
        InputError: it is not laid out for the network (`quaffure.model.groom_code`), or a root is not on the scalp.
    """
    shape, rest = config.initial_shape, rest_state(groom.rest_strands.detach(), material)
    margin = torch.full_like(rest.collision_margin, NO_CONTACT)
    if config.contact:
        margin = initial_clearance(groom, rest, material, body, shape)
    return PreparedGroom(
        groom_code(groom, body, encoder),
        groom.texels(),
        rest_strands(groom, body),
        rest.rest_length,
        margin,
        config.projection.clearance_share * rest.collision_margin,
        *cluster_representatives(groom, shape.cluster_size, shape.cluster_radius),
    )


def initial_clearance(
    groom: Groom, rest: RestState, material: HairMaterial, body: BodyModel, config: InitialShapeConfig
) -> Float[Tensor, "s n"]:
    """Distance from the point-sampled body at which strands start [m].

    Hair with higher roots lies on top: without it all hair would start in one layer, pressed to many times its density.
    No vertex starts further out than at rest, where hair may lie closer to the head than the point-sampled body is
    exact, and stiff hair not even there: where the nape wrinkles, very short hair, whose edges resist more than contact
    would push them, is not bent for some tenths of a millimetre.
    """
    height = groom.rest_strands[:, 0, 2].argsort().argsort() / len(groom)
    arc = torch.nn.functional.pad(rest.rest_length.cumsum(dim=1), (1, 0))
    ramp = (arc / config.layer_ramp).clamp(max=1)
    layered = rest.collision_margin + config.layer_thickness * height[:, None] * ramp
    at_rest = body.pose(arc.new_zeros(1, POSE_SIZE), arc.new_zeros(1, SHAPE_SIZE))
    surface = mls_body(body, at_rest, config.body)
    features = local_features(groom.rest_strands.flatten(0, 1)[None], surface).unflatten(1, layered.shape)[0]
    share = features[..., 4]
    height = surface.radius * features[..., 0] / share.clamp(min=config.min_weight_share)
    clearance = torch.where(share > config.min_weight_share, height, torch.inf)
    balanced = material.k_cosserat / (3 * material.k_body_collision * rest.rest_length.mean(1, keepdim=True).square())
    return torch.minimum(layered, clearance - (config.depth_share * balanced).clamp(max=config.max_depth))
