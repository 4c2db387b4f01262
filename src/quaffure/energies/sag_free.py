"""Sag-free rest shape: the rod whose equilibrium under gravity and contact is the groom as it was designed.

A scan or an artist's groom is hair that hangs already. Read as free of stress it would fall from there; here the rest
directions, the rest twist and the support by the body are found for which it does not (sag-free initialization: Hsu,
Wang, Wu and Yuksel 2022; Takahashi and Batty 2024). Once a groom, on the mean body in its rest pose, in float64.

With f_j the forces on the vertices of the design (weight and support s_j n_j), edge i has to transmit the moment
tau_i = sum over j > i of (x_j - x_i) x f_j. For the rod of `quaffure.energies.rod` that determines its rest shape
edge by edge, in closed form: the twist moment T_i and the bending moment m_i are

    T_i = tau_i . (t_(i-1) + t_i) / 2,    m_i = tau_i - tau_i . t_i (t_(i-1) + t_i) / (1 + t_(i-1) . t_i)

so that psi_i = -T_i / C_i, and the rest direction is p_i = sqrt(1 - |q_i|^2) t_i + q_i with q_i = t_i x m_i / B_i.
With these every derivative of the energy is zero, by directions and by twist angles (phi = 0): the equations are the
balance of moments when all beyond a joint rotates rigidly. Where |q_i| or |psi_i| would exceed a limit, the edge is
made stiffer.
"""

from dataclasses import dataclass, replace

import torch

from quaffure.body.body_model import BodyModel
from quaffure.config import STANDARD_GRAVITY, HairMaterial
from quaffure.energies.cohesion import Tails, tails_of
from quaffure.energies.held_parts import GOAL_STIFFNESS, goal_weight_of, stiffness_scale_of
from quaffure.energies.rest_state import rest_state
from quaffure.energies.rod import RodRest, in_frames, joint_stiffness, previous_frames
from quaffure.energies.rod_kernels import rod_arrays, rod_energies_and_gradient
from quaffure.energies.stability import Design, stable_factors
from quaffure.energies.support import StrandForces, solve_support, transmitted_moments
from quaffure.errors import InputError
from quaffure.geometry.polyline import directors
from quaffure.hair.clearance import distances_and_normals
from quaffure.hair.groom import Groom
from quaffure.hair.groom_cache import GroomCache
from quaffure.types import Bool, Float, Tensor

MOST_PRELOAD = 0.25
"""Largest |q|: sine of the angle between an edge of the design and its rest direction."""
MOST_REST_TWIST = 0.5
"""Largest |psi| [rad]."""
SUPPORT_DISTANCE, SUPPORT_FADE = 0.015, 0.01
"""Vertices up to this far from the skin are supported, by the skin or the hair below; beyond, fading to none [m]."""
LEAST_SUPPORT = 1e-3
"""Forces below this share of a vertex's mean weight are taken as none."""
MOST_GOAL_PRELOAD = 0.03
"""Sine of the angle between a held edge of the design and its goal direction."""


@dataclass(frozen=True, eq=False)
class SagFreeRest:
    """A rest shape at whose design all forces are balanced, on the mean body in its rest pose.

    Attributes:
        rod: rest shape and stiffness of the strands.
        collision_margin: distance D of Eq. 10 at which the body pushes each vertex with its support [m].
        distance: of each vertex of the design from the body [m].
        support: s, force of the body on each vertex of the design [N].
        normal: direction of that force, unit.
        unstable: strands that are no minimum yet, though as stiff as `stability.MOST_TRIALS` allow.
        tails: hair beyond ties, which coheres; None without.
    """

    rod: RodRest
    collision_margin: Float[Tensor, "s n"]
    distance: Float[Tensor, "s n"]
    support: Float[Tensor, "s n"]
    normal: Float[Tensor, "s n 3"]
    unstable: Bool[Tensor, " s"]
    tails: Tails | None = None


@dataclass(frozen=True, eq=False)
class _Goals:
    """Held edges, the least weight of their goals [J], and the moment that each takes [N m]."""

    held: Bool[Tensor, "s e"]
    least: Float[Tensor, "s e"]
    moment: Float[Tensor, "s e 3"]

    def weights(self, stiffness: Float[Tensor, "s e"]) -> Float[Tensor, "s e"]:
        """Weight of each goal [J], 0 for free edges, at a bending stiffness B [J]."""
        needed = self.moment.norm(dim=-1) / MOST_GOAL_PRELOAD + GOAL_STIFFNESS * stiffness
        return torch.where(self.held, torch.maximum(needed, self.least), 0.0)

    def directions(self, direction: Float[Tensor, "s e 3"], weight: Float[Tensor, "s e"]) -> Float[Tensor, "s e 3"]:
        """Goals that take their moments where the edges point along `direction`."""
        return _leaned(direction, self.moment / weight.clamp(min=1e-30)[..., None])


@dataclass(frozen=True)
class SagFreeReport:
    """What a sag-free rest shape took. Edges that are held by a goal are left out of the shares.

    Attributes:
        stiffened_percent: edges that are stiffer than the groom asks for.
        median_scale: how many times, of those edges; 1 where there are none.
        above_10_percent: edges that are more than 10 times stiffer.
        supported_percent: vertices that the body supports.
        largest_residual: of the force on any vertex, in weights of that vertex.
        unstable_strands: that would still fall from the design at a push.
    """

    stiffened_percent: float
    median_scale: float
    above_10_percent: float
    supported_percent: float
    largest_residual: float
    unstable_strands: int


def sag_free_rest(
    groom: Groom,
    body: BodyModel,
    material: HairMaterial | None = None,
    held: Bool[Tensor, "s e"] | None = None,
) -> SagFreeRest:
    """The rest shape that keeps a groom as it was designed.

    Args:
        groom: as it hangs on the mean body.
        material: weight and contact of the strands.
        held: edges that a tie or a clip holds to the direction of the design; the groom's own (`Groom.held_edges`)
            without. The weight of their goals is at least the groom's, its `stiffness_scale` multiplies B and C.

    Raises:
        InputError: a strand folds back (`previous_frames`), or a gradient is asked for in what supports are solved
            from.
    """
    material = material or HairMaterial()
    _check_no_gradient(material)
    state = rest_state(groom.rest_strands.double().cpu(), material)
    strands = state.rest_strands
    own = groom.to("cpu")
    held = own.held_edges if held is None else held.cpu()
    own_scale = stiffness_scale_of(own).double()
    distance, normal = distances_and_normals(strands, body.to("cpu").rest_surface)
    weight = STANDARD_GRAVITY * state.mass
    forces = StrandForces.of(strands, weight, normal, held, *joint_stiffness(state.rest_length, own_scale))
    available = (1 - (distance - SUPPORT_DISTANCE).clamp(min=0) / SUPPORT_FADE).clamp(0, 1)
    if not material.k_body_collision:  # no skin
        available[:] = 0
    available[:, 0] = 0
    available[:, 1:][held] = 0
    support = solve_support(forces, available)
    support = torch.where(support > LEAST_SUPPORT * weight.mean(), support, 0.0)
    margin = torch.minimum(state.collision_margin, distance)
    pressed = distance + (support / max(3 * material.k_body_collision, 1e-30)).sqrt()
    moments = transmitted_moments(forces, support)
    scale = _scale_for_preload(forces, moments)
    contact = 2 * (3 * material.k_body_collision * support).sqrt()
    goals = _Goals(held, goal_weight_of(own).double(), moments[2])
    factors, unstable = _factors_for_stability(forces, moments, goals, scale, support, contact)
    rod = _preloaded(forces, moments, goals, scale * factors)
    return SagFreeRest(
        rod=replace(rod, stiffness_scale=own_scale * rod.stiffness_scale),
        collision_margin=torch.where(support > 0, pressed, margin),
        distance=distance,
        support=support,
        normal=normal,
        unstable=unstable,
        tails=tails_of(groom),
    )


def _check_no_gradient(material: HairMaterial) -> None:
    for name in ("linear_density", "k_body_collision"):
        value = getattr(material, name)
        if isinstance(value, Tensor) and value.requires_grad:
            raise InputError(f"material, {name}", "no gradient: the rest shape of a design is solved without", "one")


def _scale_for_preload(forces: StrandForces, moments: tuple[Tensor, Tensor, Tensor]) -> Float[Tensor, "s e"]:
    """The stiffness scale at which no edge exceeds the limits of q and psi."""
    bending, twisting, _ = moments
    needed = bending.norm(dim=-1) / (MOST_PRELOAD * forces.bending_stiffness)
    return torch.maximum(needed, twisting.abs() / (MOST_REST_TWIST * forces.twisting_stiffness)).clamp(min=1)


def _factors_for_stability(
    forces: StrandForces,
    moments: tuple[Tensor, Tensor, Tensor],
    goals: _Goals,
    scale: Float[Tensor, "s e"],
    support: Float[Tensor, "s n"],
    contact_stiffness: Float[Tensor, "s n"],
) -> tuple[Float[Tensor, "s e"], Bool[Tensor, " s"]]:
    """How many times stiffer each edge has to be for the design to be a minimum, and strands that are none yet."""
    bending, twisting, _ = moments
    stiff = replace(
        forces,
        bending_stiffness=scale * forces.bending_stiffness,
        twisting_stiffness=scale * forces.twisting_stiffness,
    )
    weight = goals.weights(stiff.bending_stiffness)
    pull = weight[..., None] * goals.directions(forces.direction, weight)
    arrays = (support, contact_stiffness, bending, twisting, pull)
    factors, unstable = torch.ones_like(scale), torch.zeros(len(scale), dtype=torch.bool)
    stable_factors(
        Design(*stiff.arrays(), *(array.contiguous().numpy() for array in arrays)), factors.numpy(), unstable.numpy()
    )
    return factors, unstable


def _preloaded(
    forces: StrandForces,
    moments: tuple[Tensor, Tensor, Tensor],
    goals: _Goals,
    scale: Float[Tensor, "s e"],
) -> RodRest:
    """Rest directions, rest twist and goals that transmit the moments (the module's equations)."""
    (bending, twisting, _), direction = moments, forces.direction
    stiffness = scale * forces.bending_stiffness
    weight = goals.weights(stiffness)
    before, normal = previous_frames(direction)
    return RodRest(
        bending_stiffness=stiffness,
        twisting_stiffness=scale * forces.twisting_stiffness,
        rest_direction=in_frames(_leaned(direction, bending / stiffness[..., None]), before, normal),
        rest_twist=-twisting / (scale * forces.twisting_stiffness),
        root_frame=torch.stack([before[:, 0], normal[:, 0]], dim=1),
        stiffness_scale=scale,
        goal_weight=weight,
        goal_direction=goals.directions(direction, weight),
    )


def _leaned(direction: Float[Tensor, "s e 3"], moment: Float[Tensor, "s e 3"]) -> Float[Tensor, "s e 3"]:
    """Unit p with t x p = -moment, on the side of the unit direction t; the moment is across t and below 1."""
    lean = torch.linalg.cross(direction, moment)
    return (1 - lean.square().sum(-1, keepdim=True)).clamp(min=0).sqrt() * direction + lean


_DESIGNS: GroomCache[dict[tuple[BodyModel, HairMaterial], SagFreeRest]] = GroomCache()


def design_of(groom: Groom, body: BodyModel, material: HairMaterial) -> SagFreeRest:
    """`sag_free_rest`, computed once for a groom, a body and a material. Arguments and errors are the same."""
    designs = _DESIGNS.of(groom, dict)
    if (body, material) not in designs:
        designs[body, material] = sag_free_rest(groom, body, material)
    return designs[body, material]


def residual(groom: Groom, rest: SagFreeRest) -> Float[Tensor, "s e"]:
    """Force that is left on each edge of the design, in weights of the vertex at its end; twist is at its equilibrium
    and the material is the default one.

    From the gradient of the compiled rod energy in float64, so it checks the rest shape's derivation as well.
    """
    state = rest_state(groom.rest_strands.double().cpu(), HairMaterial())
    strands, weight = state.rest_strands, STANDARD_GRAVITY * state.mass
    rotation = torch.eye(3, dtype=torch.float64).expand(1, len(strands), 3, 3)
    _, gradient = rod_energies_and_gradient(strands[None], rod_arrays(rest.rod, torch.float64), rotation)
    down = strands.new_tensor([0.0, 0.0, -1.0])
    force = weight[..., None] * down + rest.support[..., None] * rest.normal - gradient[0]
    direction = directors(strands)
    beyond = force[:, 1:].flip(1).cumsum(1).flip(1)
    across = beyond - (beyond * direction).sum(-1, keepdim=True) * direction
    return across.norm(dim=-1) / weight[:, 1:]


def sag_free_report(groom: Groom, rest: SagFreeRest) -> SagFreeReport:
    """What the rest shape of a groom took, of the default material."""
    own = stiffness_scale_of(groom.to("cpu")).double()
    scale = (rest.rod.stiffness_scale / own)[rest.rod.goal_weight == 0]
    stiffened = scale[scale > 1]
    return SagFreeReport(
        stiffened_percent=100 * len(stiffened) / max(len(scale), 1),
        median_scale=float(stiffened.median()) if len(stiffened) else 1.0,
        above_10_percent=100 * int((scale > 10).sum()) / max(len(scale), 1),
        supported_percent=100 * float((rest.support[:, 1:] > 0).double().mean()),
        largest_residual=float(residual(groom, rest).max()),
        unstable_strands=int(rest.unstable.sum()),
    )
