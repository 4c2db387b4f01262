"""Projection of strands out of the body: exact distances, displacements that fade along the strand, kept lengths."""

import torch

from quaffure.config import HairMaterial
from quaffure.geometry.polyline import arc_lengths, directors, integrate_directions_reference
from quaffure.geometry.signed_distance import surface_offsets
from quaffure.geometry.surface import Surface
from quaffure.geometry.winding_number import is_inside
from quaffure.types import Bool, Float, Int, Tensor

# Grooms are laid out for the collision margins of hair as it is by default.
CLEARANCE, CLEARANCE_RAMP = HairMaterial.collision_margin, HairMaterial.collision_ramp
"""Distance that rest strands keep from the skin [m], and its increase per length of strand from the root."""
# Smallest clearance of a vertex, next to the root: the sign of a distance of zero is rounding [m].
LEAST_CLEARANCE = 1e-4
# Share of a vertex's displacement that its successor and its predecessor take, so that the strand bends smoothly.
TIPWARD_SHARE, ROOTWARD_SHARE = 0.8, 0.4
ROUNDS, FINAL_ROUNDS = 40, 10
CAUGHT_FOLDS = 2
"""A strand that turns by more than a right angle at as many vertices hangs on something, such as an ear."""
LONGEST_MOVED = 1.03
"""Largest length of a strand whose vertices are moved out by themselves, in lengths of before."""
SPREAD, SPREAD_ROUNDS, SPREAD_PUSHES = 3.0, 6, 4
"""How far `pushed_out_smoothly` spreads bends in its first round [edges^2], its rounds, and pushes after each."""
# Damping for displacements in opposite directions (hair between neck and shoulder).
STEP = 0.9


def distances_and_normals(
    points: Float[Tensor, "*batch 3"], surface: Surface
) -> tuple[Float[Tensor, "*batch"], Float[Tensor, "*batch 3"]]:
    """Exact signed distance to the surface's first sample [m] and the outward unit direction away from it."""
    offset, normal = surface_offsets(points.reshape(1, -1, 3), surface)
    # The product alone has other last bits. Rounds of pushing out enlarge them: bundled styles, of which the measured
    # numbers are, would be other grooms, by up to 1 mm in a vertex.
    distance = torch.where((offset * normal).sum(-1) < 0, -1.0, 1.0) * offset.norm(dim=-1)
    return distance.reshape(points.shape[:-1]), normal.reshape(points.shape)


def inside_share(strands: Float[Tensor, "s n 3"], surface: Surface) -> float:
    """Share of vertices, without the roots, strictly inside the body."""
    arrays = (strands[:, 1:], surface.vertices[0], surface.topology.faces)
    return float(is_inside(*(array.detach().cpu().numpy() for array in arrays)).mean())


def required_clearance(strands: Float[Tensor, "s n 3"]) -> Float[Tensor, "s n"]:
    """Smallest distance of each vertex from the skin [m]: zero at the root, rising to `CLEARANCE`."""
    needed = (CLEARANCE_RAMP * arc_lengths(strands)).clamp(min=LEAST_CLEARANCE, max=CLEARANCE)
    needed[:, 0] = 0
    return needed


def pushed_out(strands: Float[Tensor, "s n 3"], surface: Surface) -> Float[Tensor, "s n 3"]:
    """Strands whose vertices keep `required_clearance` from the body; roots stay, edges keep their lengths.

    Vertices still inside after the rounds (in a fold of the skin) are moved out without regard to length, and so are
    those of a strand that was caught and folds back, as above an ear through which it leads, where that lengthens it
    by little (`LONGEST_MOVED`). Deep inside, neighbouring vertices may leave through different sides, and the strand
    between them would cross the body.
    """
    result = _pushed_keeping_lengths(strands, surface)
    caught = (_folds(result) >= CAUGHT_FOLDS) & (_folds(strands) == 0)
    if caught.any():
        rows, own = caught.nonzero()[:, 0], strands[caught]
        moved = _moved_out(own, required_clearance(own), surface)
        alike = arc_lengths(moved)[:, -1] < LONGEST_MOVED * arc_lengths(own)[:, -1]
        result[rows[alike]] = moved[alike]
    return result


def pushed_out_smoothly(strands: Float[Tensor, "s n 3"], surface: Surface) -> Float[Tensor, "s n 3"]:
    """`pushed_out`, with the bends that this adds spread along the strands.

    Vertices that are pushed out one after the other leave a zigzag. Here what the direction of each edge has changed by
    is smoothed along its strand, dev <- (I + a D^T D)^-1 dev with D the difference of neighbours, and the strand is
    pushed out again, for some rounds in which a falls. A strand deep inside that ends less smooth stays as it was.
    """
    result = pushed_out(strands, surface)
    rows = ((result - strands).norm(dim=-1).amax(dim=1) > LEAST_CLEARANCE).nonzero()[:, 0]
    straight, lengths = directors(strands[rows]), strands[rows].diff(dim=1).norm(dim=-1)
    spread = result[rows]
    for index in range(SPREAD_ROUNDS):
        change = _smoothed(directors(spread) - straight, SPREAD * (1 - index / SPREAD_ROUNDS))
        spread = integrate_directions_reference(spread[None, :, 0], (straight + change)[None], lengths)[0]
        spread = _push_repeatedly(spread, surface, SPREAD_PUSHES)[0]
    spread = pushed_out(spread, surface)
    both = (directors(shape) - straight for shape in (result[rows], spread))
    before, after = (change.diff(dim=1).square().sum(dim=(1, 2)) for change in both)
    result[rows[after < before]] = spread[after < before]
    return result


def _smoothed(values: Float[Tensor, "s e 3"], amount: float) -> Float[Tensor, "s e 3"]:
    """Values along strands without what changes from edge to edge: (I + amount D^T D)^-1."""
    difference = torch.eye(values.shape[1]).to(values).diff(dim=0)
    system = torch.eye(values.shape[1]).to(values) + amount * difference.T @ difference
    return torch.linalg.inv(system) @ values


def _pushed_keeping_lengths(strands: Float[Tensor, "s n 3"], surface: Surface) -> Float[Tensor, "s n 3"]:
    result, active = _push_repeatedly(strands, surface, ROUNDS)
    if len(active):
        result[active] = _moved_out(result[active], required_clearance(strands)[active], surface)
    return result


def _push_repeatedly(
    strands: Float[Tensor, "s n 3"], surface: Surface, rounds: int
) -> tuple[Float[Tensor, "s n 3"], Int[Tensor, " a"]]:
    """Strands after some pushes that keep their lengths, and those that were too close before the last."""
    lengths = strands.diff(dim=1).norm(dim=-1)
    needed = required_clearance(strands)
    result = strands.clone()
    active = torch.arange(len(strands))
    for _ in range(rounds):
        push, deep = _push(result[active], needed[active], surface)
        active, push = active[deep], push[deep]
        if len(active) == 0:
            break
        moved = result[active] + STEP * push
        result[active] = integrate_directions_reference(moved[None, :, 0], moved.diff(dim=1)[None], lengths[active])[0]
    return result, active


def _moved_out(
    strands: Float[Tensor, "s n 3"], needed: Float[Tensor, "s n"], surface: Surface
) -> Float[Tensor, "s n 3"]:
    """Every vertex moved out by itself, to half of the distance that it needs."""
    result = strands.clone()
    for _ in range(FINAL_ROUNDS):
        distance, normal = distances_and_normals(result, surface)
        short = (0.5 * needed - distance).clamp(min=0)
        short[:, 0] = 0
        result += short[..., None] * normal
    return result


def _folds(strands: Float[Tensor, "s n 3"]) -> Int[Tensor, " s"]:
    """How often each strand turns by more than a right angle from one edge to the next."""
    edges = strands.diff(dim=1)
    return ((edges[:, 1:] * edges[:, :-1]).sum(-1) < 0).sum(1)


def _push(
    strands: Float[Tensor, "s n 3"], needed: Float[Tensor, "s n"], surface: Surface
) -> tuple[Float[Tensor, "s n 3"], Bool[Tensor, " s"]]:
    """Displacement of every vertex, and whether each strand is too close by more than a tenth of a millimetre."""
    distance, normal = distances_and_normals(strands, surface)
    short = (needed - distance).clamp(min=0)
    short[:, 0] = 0
    push = list((short[..., None] * normal).unbind(1))
    free = (short == 0)[..., None].unbind(1)
    for vertex in range(2, len(push)):
        push[vertex] = torch.where(free[vertex], TIPWARD_SHARE * push[vertex - 1], push[vertex])
    for vertex in range(len(push) - 2, 0, -1):
        push[vertex] = torch.where(
            free[vertex] & (push[vertex].norm(dim=-1, keepdim=True) < 1e-9),
            ROOTWARD_SHARE * push[vertex + 1],
            push[vertex],
        )
    return torch.stack(push, dim=1), (short > 1e-4).any(1)
