"""What a drape reads of a groom on a body, whatever the pose."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import torch

from quaffure.body.body_model import BodyModel
from quaffure.body.mls_body import mls_body
from quaffure.body.pose_features import HEAD
from quaffure.config import STANDARD_GRAVITY, TEXTURE_SIZE, VERTICES_PER_STRAND, HairMaterial
from quaffure.energies.rest_state import rest_state
from quaffure.energies.sag_free import SagFreeRest, design_of
from quaffure.geometry.mls_kernels import LANES
from quaffure.geometry.mls_surface import local_features
from quaffure.geometry.sampling import spatial_order
from quaffure.hair.block_arrays import StrandBlocks
from quaffure.hair.groom import Groom
from quaffure.hair.posing import rest_frames, ties_of
from quaffure.hair.strand_blocks import RestStrands, in_blocks, rest_strands, strand_blocks
from quaffure.model.groom_code import groom_code
from quaffure.model.groom_encoder import GroomEncoder
from quaffure.model.inference_network import StrandTexels, texture_rows
from quaffure.model.initial_shape_kernels import RodBlocks
from quaffure.model.network_config import (
    POSE_SIZE,
    SHAPE_SIZE,
    DensityGridConfig,
    InitialShapeConfig,
    NetworkConfig,
)
from quaffure.model.projection_kernel import PushedRods
from quaffure.model.surroundings import Surroundings, coarse_density
from quaffure.types import Float, Int, RestLengths, Tensor

NO_CONTACT = -10.0
"""A margin that is kept everywhere [m]."""
_LEAST_UPNESS = 0.1


class DesignRods(NamedTuple):
    """Strands as rods that rest in their design, in the frames of `RestStrands`; in weights of a metre of hair.

    Attributes:
        moment: that each joint transmits in the design [m^2].
        support: force of the body on the vertex at the end of each edge, in the design.
        upness: 1 + cosine of the angle between that force and up.
        mass: of these vertices [m].
        bending: B of each joint [m^2].
        goal: stiffness of what holds an edge to the posed design [m^2].
        compliance: rotation of each joint by the weight beyond it and a share of the strand's at its tip [rad], the
            smaller of sum(arm x load) / B, where the joint alone resists, and sqrt(l W / B), where tension does; zero
            where a goal holds it. Taken as linear in the loading.
    """

    moment: Float[Tensor, "s e 3"]
    support: Float[Tensor, "s e 3"]
    upness: Float[Tensor, "s e"]
    mass: Float[Tensor, "s e"]
    bending: Float[Tensor, "s e"]
    goal: Float[Tensor, "s e"]
    compliance: Float[Tensor, "s e"]

    def stiffened(self, factor: float | Float[Tensor, "s e"]) -> "DesignRods":
        """The same strands, whose joints are stiffer by a factor; their rest shape stays."""
        moment = (factor[..., None] if isinstance(factor, Tensor) else factor) * self.moment
        compliance = self.compliance / factor
        return self._replace(moment=moment, bending=factor * self.bending, compliance=compliance)


class KernelBlocks(NamedTuple):
    """A groom as the compiled kernels read it; a row is a lane of a block.

    Attributes:
        strands, rods: all strands.
        rows: of the kernels' results, for each strand.
        texels: of each row.
        surroundings: `Surroundings` of each row but those that repeat the last strand.
        pushed: strands in their own order, for the projection out of the skin.
    """

    strands: StrandBlocks
    rods: RodBlocks
    rows: Int[np.ndarray, "block lane"]
    texels: StrandTexels
    surroundings: tuple[np.ndarray, ...]
    pushed: PushedRods

    @property
    def nbytes(self) -> int:
        """Memory that the kernels read [bytes]."""
        return sum(array.nbytes for array in (*self.strands, *self.rods, self.texels.rows, *self.pushed))


@dataclass(frozen=True, eq=False)
class PreparedGroom:
    """A groom on a body, prepared once for all poses.

    Attributes:
        code: of the frozen encoder.
        texels: flat index of each strand's texel.
        strands, rods: in the frames in which strands move rigidly.
        rest_length: of every edge [m].
        initial_clearance: distance from the point-sampled body at which strands start [m].
        clearance: distance up to which hair is projected out of the skin [m], see `quaffure.model.projection`.
        most_clearance: of all grooms of the material [m].
        surroundings: of each strand.
        order: of the strands in the kernels' blocks, near ones next to each other.
    """

    code: Float[Tensor, "16"]
    texels: Int[Tensor, " s"]
    strands: RestStrands
    rods: DesignRods
    rest_length: RestLengths
    initial_clearance: Float[Tensor, "s n"]
    clearance: Float[Tensor, "s n"]
    most_clearance: float
    surroundings: Surroundings
    order: Int[Tensor, " s"]

    @cached_property
    def blocks(self) -> KernelBlocks:
        """Laid out for the compiled kernels; float32, on the CPU."""
        strands = strand_blocks(self.strands, self.initial_clearance, self.order)
        of_rows = torch.from_numpy(strands.strand).flatten().long()
        texels = StrandTexels(self.texels[of_rows], texture_rows(self.texels[of_rows], TEXTURE_SIZE), of_rows)
        rows = np.arange(strands.strand.size, dtype=np.int32).reshape(strands.strand.shape)
        rods = RodBlocks(*(in_blocks(values[of_rows]) for values in self.rods))
        own = of_rows[: len(self.initial_clearance)]
        around = tuple(values[own].numpy() for values in self.surroundings)
        pushed = (self.rest_length, self.clearance, self.rods.bending, self.rods.goal)
        return KernelBlocks(
            strands, rods, rows, texels, around, PushedRods(*(values.detach().numpy() for values in pushed))
        )

    def stiffened(self, factor: Float[Tensor, "s e"]) -> "PreparedGroom":
        """The same groom with each edge stiffer by a factor of its own."""
        return replace(self, rods=self.rods.stiffened(factor))


def prepare_groom(
    groom: Groom, body: BodyModel, encoder: GroomEncoder, config: NetworkConfig, material: HairMaterial
) -> PreparedGroom:
    """Prepare a groom that is registered to `body`.

    Raises:
        InputError: it is not laid out for the network (`quaffure.model.groom_code`), a root is not on the scalp, or a
            strand folds back.
    """
    strands, design = rest_strands(groom, body), design_of(groom, body, material)
    shape, design_margin = config.initial_shape, design.collision_margin.to(groom.rest_strands)
    start = clearance = torch.full_like(design_margin, NO_CONTACT)
    most_clearance = max(config.projection.most, float(material.collision_margin))
    if config.contact:
        held = torch.nn.functional.pad(design.rod.goal_weight > 0, (1, 0)).to(groom.rest_strands.device)
        depth = balanced_depth(design, groom.rest_lengths, material, shape)
        start = initial_clearance(groom, design_margin, body, shape) - depth
        start = limit_slope(torch.where(held, NO_CONTACT, start), groom.rest_lengths, shape.margin_slope)
        clearance = config.projection.clearance(design_margin, depth, most_clearance)
        at_rest, slope = design.distance.to(groom.rest_strands), config.projection.clearance_slope
        clearance = raised_before_supports(clearance, groom.rest_lengths, at_rest, slope)
        clearance = torch.where(held, NO_CONTACT, clearance)
    # Roots count most, for there the skin is.
    roots, middles, tips = groom.rest_strands[:, [0, VERTICES_PER_STRAND // 2, -1]].unbind(1)
    positions = torch.cat([roots, 0.5 * middles, 0.5 * tips], dim=1)
    return PreparedGroom(
        groom_code(groom, body, encoder),
        groom.texels(),
        strands,
        design_rods(groom, body, design, material, shape.load_share),
        groom.rest_lengths,
        start,
        clearance,
        most_clearance,
        surroundings_of(groom, body, material, design_margin, config.density_grid),
        spatial_order(positions, LANES),
    )


def surroundings_of(
    groom: Groom, body: BodyModel, material: HairMaterial, margin: Float[Tensor, "s n"], grid: DensityGridConfig
) -> Surroundings:
    """What the surroundings of strands are measured against: upright, on the mean body, no density is in excess.

    Args:
        margin: distance from the body that each vertex is to keep [m].
    """
    mass = rest_state(groom.rest_strands, material).mass
    _, joints = body.posed_joints(mass.new_zeros(1, POSE_SIZE), mass.new_zeros(1, SHAPE_SIZE))
    head = joints[0, body.joint_names.index(HEAD)]
    density, _ = coarse_density((groom.rest_strands - head)[None], mass, grid.cell)
    return Surroundings(groom.rest_lengths, mass, density[0], margin)


def design_rods(
    groom: Groom, body: BodyModel, design: SagFreeRest, material: HairMaterial, load_share: float
) -> DesignRods:
    """Strands as rods at rest in their design.

    Args:
        design: sag-free rest shape of the groom on the body.
        load_share: share of a strand's weight that may push its tip, for the compliance.
    """
    state = rest_state(groom.rest_strands.double(), material)
    weight = float(material.linear_density) * STANDARD_GRAVITY
    mass, length = state.mass / float(material.linear_density), state.rest_length
    support = design.support.to(mass)[..., None] * design.normal.to(mass) / weight
    up = mass.new_tensor([0.0, 0.0, 1.0])
    beyond = (support - mass[..., None] * up)[:, 1:].flip(1).cumsum(1).flip(1)
    edges = groom.rest_strands.double().diff(dim=1)
    moment = torch.linalg.cross(edges, beyond, dim=-1).flip(1).cumsum(1).flip(1)
    frames = rest_frames(groom, body, ties_of(groom, body)).to(mass)
    upness = (1 + design.normal.to(mass)[:, 1:] @ up).clamp(min=_LEAST_UPNESS)
    bending, goal = design.rod.bending_stiffness.to(mass) / weight, design.rod.goal_weight.to(mass) / weight
    load = mass[:, 1:].clone()
    load[:, -1] += load_share * mass.sum(1)
    # From the vertex before each edge to all that are beyond it.
    arms = (groom.rest_strands.double()[:, None, 1:] - groom.rest_strands.double()[:, :-1, None]).norm(dim=-1).triu()
    bent = (arms @ load[..., None])[..., 0] / bending
    tense = (length * load.flip(1).cumsum(1).flip(1) / bending).sqrt()
    compliance = torch.where(goal > 0, 0.0, torch.minimum(bent, tense))
    parts = (moment @ frames, support[:, 1:] @ frames, upness, mass[:, 1:], bending, goal, compliance)
    return DesignRods(*(part.to(groom.rest_strands) for part in parts))


def balanced_depth(
    design: SagFreeRest, rest_length: RestLengths, material: HairMaterial, config: InitialShapeConfig
) -> Float[Tensor, "s 1"]:
    """Depth below its margin to which hair is left alone because it is stiff [m].

    Where the nape wrinkles, the point-sampled skin is untrue by tenths of a millimetre, which would bend very short
    edges by a radian: a share of the depth at which Eq. 10 pushes an edge as hard as the joint before it resists.
    """
    stiffness = (
        (design.rod.bending_stiffness.to(rest_length) / rest_length.clamp(min=1e-4).square()).median(dim=1).values
    )
    balanced = stiffness / (3 * material.k_body_collision)
    return (config.depth_share * balanced).clamp(max=config.max_depth)[:, None]


def initial_clearance(
    groom: Groom, margin: Float[Tensor, "s n"], body: BodyModel, config: InitialShapeConfig
) -> Float[Tensor, "s n"]:
    """Distance from the point-sampled body at which strands start [m].

    The collision margin of the design, but no vertex starts further out than at rest, where hair may lie closer to the
    head than the point-sampled body is exact.
    """
    at_rest = body.pose(margin.new_zeros(1, POSE_SIZE), margin.new_zeros(1, SHAPE_SIZE))
    surface = mls_body(body, at_rest, config.body)
    features = local_features(groom.rest_strands.flatten(0, 1)[None], surface).unflatten(1, margin.shape)[0]
    share = features[..., 4]
    height = surface.radius * features[..., 0] / share.clamp(min=config.min_weight_share)
    return torch.minimum(margin, torch.where(share > config.min_weight_share, height, torch.inf))


def limit_slope(margin: Float[Tensor, "s n"], rest_length: RestLengths, slope: float) -> Float[Tensor, "s n"]:
    """Margins that grow along a strand by no more than a share of the way [m]: from one vertex in contact to the next
    with a wider margin, an edge would stand off the skin."""
    kept = [margin[:, 0]]
    for vertex in range(1, margin.shape[1]):
        kept.append(torch.minimum(margin[:, vertex], kept[-1].clamp(min=0) + slope * rest_length[:, vertex - 1]))
    return torch.stack(kept, dim=1)


def raised_before_supports(
    clearance: Float[Tensor, "s n"], rest_length: RestLengths, at_rest: Float[Tensor, "s n"], slope: float
) -> Float[Tensor, "s n"]:
    """Distances to keep from the body, raised before vertices that need more, up to their distance in the design [m].

    The body supports a design at single vertices, which keep 2 cm where others of their strand keep 3 mm. Where a
    shoulder comes near, a strand would go straight down to the skin and fold there.

    Args:
        clearance: distance that each vertex needs by itself [m].
        at_rest: distance of each vertex in the design, which is the most that those before others get [m].
        slope: what they may be less than at the next vertex, for each length between the two.
    """
    kept = [clearance[:, -1]]
    for vertex in range(clearance.shape[1] - 2, -1, -1):
        wanted = torch.minimum(kept[-1] - slope * rest_length[:, vertex], at_rest[:, vertex])
        kept.append(torch.maximum(clearance[:, vertex], wanted))
    return torch.stack(kept[::-1], dim=1)
