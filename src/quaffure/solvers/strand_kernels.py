"""Whole strands that move by themselves, in compiled passes: energy and gradient, rotated edges, resolved contact.

A strand's own energy is the rod, its weight and contact. The hair around it is held; Eq. 11 is replaced by a quadratic
model. The same own energy in torch is `HairEnergy` without that term; a test holds the two together.
"""

from typing import NamedTuple

import numpy as np
from numba import njit, prange

from quaffure.energies.fused_strand import contact_of_strand, gravity_of_strand
from quaffure.energies.rod_kernels import RodArrays, rod_of_strand, rod_workspace
from quaffure.geometry.bvh import search_workspace
from quaffure.geometry.cell_list import interleaved
from quaffure.geometry.polyline import integrate_strand
from quaffure.geometry.rotation_kernel import rotated_by_gibbs
from quaffure.geometry.surface import SurfaceArrays
from quaffure.geometry.surface_distance import distance_within

_RUN = 16  # strands that one thread takes in turn: near neighbours, each finds a face that the next starts from
_STRIDE = 16  # runs between one that a thread takes and its next: dense hair is shared by all threads
_ZERO, _HALF, _ONE, _TINY = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(1e-12)
_TINY_FORCE = np.float32(1e-30)  # [N]
_MOST_PUSH = np.float32(3.0)  # lengths of its edge by which a vertex is pushed out at most


class StrandArrays(NamedTuple):
    """A groom in one pose.

    Attributes:
        rotation: of every scalp triangle from rest [strand 3 3].
        root: positions of the roots [m], [strand 3].
        length: of every edge [m], [strand edge].
        mass: of every vertex [kg], [strand vertex].
        acceleration: g of Eq. 9 [m/s^2], [3].
        margin: D of Eq. 10 [m], [strand vertex].
    """

    rotation: np.ndarray
    root: np.ndarray
    length: np.ndarray
    mass: np.ndarray
    acceleration: np.ndarray
    margin: np.ndarray


class DensityModel(NamedTuple):
    """Quadratic model of the energy of hair against hair, at every vertex.

    Attributes:
        gradient: [N], [strand vertex 3].
        stiffness: in all directions [N/m], [strand vertex].
        positions: where the model was made [m].
    """

    gradient: np.ndarray
    stiffness: np.ndarray
    positions: np.ndarray


class Evaluation(NamedTuple):
    """What `evaluate_strands` fills.

    Attributes:
        positions: of the vertices [m].
        energy: own energy of every strand, and the model's of its surroundings, zero where that was made [J];
            float64 [strand 2].
        gradient: of the own energy by the vertices [N].
        contact: unit normal, and how far within its margin every vertex is [m], [strand vertex 4].
    """

    positions: np.ndarray
    energy: np.ndarray
    gradient: np.ndarray
    contact: np.ndarray


@njit(cache=True, parallel=True, fastmath=True, error_model="numpy")
def evaluate_strands(
    direction: np.ndarray, strands: np.ndarray, hair: StrandArrays, rest: RodArrays, around: DensityModel,
    body: SurfaceArrays, k_body_collision: float | np.floating, out: Evaluation,
) -> None:  # fmt: skip
    """Evaluate the `strands` listed, whose edges have the `direction` [strand edge 3]; no contact where its stiffness
    is 0."""
    runs = (len(strands) + _RUN - 1) // _RUN
    for index in prange(runs + _STRIDE):
        run = interleaved(index, runs, _STRIDE)
        if run < runs:
            part = strands[run * _RUN : (run + 1) * _RUN]
            _evaluate_run(direction, part, hair, rest, around, body, k_body_collision, out)


@njit(cache=True, fastmath=True, error_model="numpy")
def _evaluate_run(
    direction: np.ndarray, strands: np.ndarray, hair: StrandArrays, rest: RodArrays, around: DensityModel,
    body: SurfaceArrays, k_body_collision: float | np.floating, out: Evaluation,
) -> None:  # fmt: skip
    work = rod_workspace(direction.shape[1], direction)
    workspace = search_workspace()
    leaf = int(np.int64(0))  # a literal would be a type of its own, for which the search is compiled again
    for strand in strands:
        x, gradient, contact = out.positions[strand], out.gradient[strand], out.contact[strand]
        integrate_strand(hair.root[strand], direction[strand], hair.length[strand], True, x)
        energy = gravity_of_strand(x, hair.mass[strand], hair.acceleration, gradient)
        energy += float(rod_of_strand(x, hair.rotation[strand], rest, strand, work, gradient))
        contact[:, 3] = _ZERO
        if k_body_collision > _ZERO:
            pressed, leaf = contact_of_strand(
                x, hair.margin[strand], k_body_collision, body, leaf, workspace, gradient, contact
            )
            energy += pressed
        out.energy[strand, 0] = energy
        out.energy[strand, 1] = _squeeze(x, around.gradient[strand], around.stiffness[strand], around.positions[strand])


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def _squeeze(x: np.ndarray, slope: np.ndarray, stiffness: np.ndarray, positions: np.ndarray) -> float:
    """Energy of the model of a strand's surroundings."""
    energy = 0.0
    for vertex in range(len(x)):
        for axis in range(3):
            moved = x[vertex, axis] - positions[vertex, axis]
            energy += (slope[vertex, axis] + _HALF * stiffness[vertex] * moved) * moved
    return energy


@njit(cache=True, parallel=True, error_model="numpy")
def model_surroundings(
    gradient: np.ndarray, most_force: np.ndarray, damping: np.ndarray, damping_weight: np.ndarray,
    yield_distance: float | np.floating, positions: np.ndarray, out: DensityModel,
) -> None:  # fmt: skip
    """Fill a model with forces of at most `most_force` [strand] [N], and with stiffnesses by which these yield over a
    distance [m].

    Args:
        gradient: of the energy of hair against hair by the vertices [N], [strand vertex 3].
        damping: d of every strand: 1 + d times the stiffness, and d times that of its weight.
        damping_weight: of every vertex, as much of it as damps [N], [strand vertex].
        positions: of the vertices [m].
    """
    limited, stiffness, origin = out
    for strand in prange(len(gradient)):
        origin[strand] = positions[strand]
        most, damped = most_force[strand], damping[strand]
        for vertex in range(gradient.shape[1]):
            x, y, z = gradient[strand, vertex, 0], gradient[strand, vertex, 1], gradient[strand, vertex, 2]
            size = np.sqrt(x * x + y * y + z * z)
            force = min(size, most)
            scale = force / max(size, _TINY_FORCE)
            limited[strand, vertex, 0], limited[strand, vertex, 1] = scale * x, scale * y
            limited[strand, vertex, 2] = scale * z
            resisted = force + damped * (force + damping_weight[strand, vertex])
            stiffness[strand, vertex] = resisted / yield_distance


@njit(cache=True, parallel=True, error_model="numpy")
def take_strands(
    strands: np.ndarray, trial_direction: np.ndarray, trial: Evaluation, direction: np.ndarray, now: Evaluation,
    moved: np.ndarray,
) -> None:  # fmt: skip
    """Copy directions and evaluation of the `strands` listed, and write the largest displacement of their vertices
    [m]."""
    # Taken apart here: assigned to through the tuple, inside the loop, the arrays stay as they are (numba 0.68).
    positions, energy, gradient, contact = now
    other_positions, other_energy, other_gradient, other_contact = trial
    for index in prange(len(strands)):
        strand = strands[index]
        moved[strand] = _largest_displacement(other_positions[strand], positions[strand])
        direction[strand], positions[strand] = trial_direction[strand], other_positions[strand]
        energy[strand], gradient[strand] = other_energy[strand], other_gradient[strand]
        contact[strand] = other_contact[strand]


@njit(cache=True, parallel=True, error_model="numpy")
def largest_displacements(positions: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Largest displacement of a vertex of each strand [m], [strand]."""
    found = np.empty(len(positions), np.float32)
    for strand in prange(len(positions)):
        found[strand] = _largest_displacement(positions[strand], before[strand])
    return found


@njit(cache=True, error_model="numpy", inline="always")
def _largest_displacement(positions: np.ndarray, before: np.ndarray) -> np.floating:
    most = _ZERO
    for vertex in range(len(positions)):
        x, y = positions[vertex, 0] - before[vertex, 0], positions[vertex, 1] - before[vertex, 1]
        z = positions[vertex, 2] - before[vertex, 2]
        most = max(most, x * x + y * y + z * z)
    return np.sqrt(most)


@njit(cache=True, parallel=True, fastmath=True, error_model="numpy")
def limit_rotations(
    direction: np.ndarray, length: np.ndarray, strands: np.ndarray, most_turn: float | np.floating,
    most_move: np.ndarray, rotation: np.ndarray,
) -> None:  # fmt: skip
    """Take the twist off the rotations of the `strands` listed, and shorten them: no edge turns by more than
    `most_turn` [rad], and no vertex by more than its strand's `most_move` [m], both to first order."""
    for index in prange(len(strands)):
        strand = strands[index]
        _limit_strand(direction[strand], length[strand], most_turn, most_move[strand], rotation[strand])


@njit(cache=True, fastmath=True, error_model="numpy")
def _limit_strand(
    direction: np.ndarray,
    length: np.ndarray,
    most_turn: float | np.floating,
    most_move: float | np.floating,
    rotation: np.ndarray,
) -> None:
    ux, uy, uz, farthest = _ZERO, _ZERO, _ZERO, _ZERO
    for edge in range(len(length)):
        tx, ty, tz = direction[edge, 0], direction[edge, 1], direction[edge, 2]
        rx, ry, rz = rotation[edge, 0], rotation[edge, 1], rotation[edge, 2]
        along = rx * tx + ry * ty + rz * tz
        rx, ry, rz = rx - along * tx, ry - along * ty, rz - along * tz
        share = min(_ONE, most_turn / max(np.sqrt(rx * rx + ry * ry + rz * rz), _TINY))
        rx, ry, rz = share * rx, share * ry, share * rz
        rotation[edge, 0], rotation[edge, 1], rotation[edge, 2] = rx, ry, rz
        ux += length[edge] * (ry * tz - rz * ty)
        uy += length[edge] * (rz * tx - rx * tz)
        uz += length[edge] * (rx * ty - ry * tx)
        farthest = max(farthest, ux * ux + uy * uy + uz * uz)
    rotation *= min(_ONE, most_move / max(np.sqrt(farthest), _TINY))


@njit(cache=True, parallel=True, fastmath=True, error_model="numpy")
def rotate_edges(
    direction: np.ndarray, rotation: np.ndarray, step: float | np.floating, strands: np.ndarray, out: np.ndarray
) -> None:
    """Directions of the `strands` listed, rotated by `step` times `rotation`, which is across them."""
    for index in prange(len(strands)):
        strand = strands[index]
        for edge in range(direction.shape[1]):
            tx, ty, tz = direction[strand, edge, 0], direction[strand, edge, 1], direction[strand, edge, 2]
            rx, ry, rz = rotation[strand, edge, 0], rotation[strand, edge, 1], rotation[strand, edge, 2]
            angle = np.sqrt(rx * rx + ry * ry + rz * rz)
            half = np.tan(_HALF * step * angle) / max(angle, _TINY)
            vx, vy, vz = rotated_by_gibbs((half * rx, half * ry, half * rz), (tx, ty, tz))
            inverse = _ONE / max(np.sqrt(vx * vx + vy * vy + vz * vz), _TINY)
            out[strand, edge, 0], out[strand, edge, 1], out[strand, edge, 2] = inverse * vx, inverse * vy, inverse * vz


@njit(cache=True, parallel=True, fastmath=True, error_model="numpy")
def resolve_strands(
    direction: np.ndarray, hair: StrandArrays, goal_weight: np.ndarray, body: SurfaceArrays, share: float | np.floating
) -> None:
    """From root to tip, push every vertex that is nearer to the body than `share` of its margin out to there; what
    hangs on it moves along. Edges that a goal holds stay. Changes the directions [strand edge 3]."""
    runs = (len(direction) + _RUN - 1) // _RUN
    for index in prange(runs + _STRIDE):
        run = interleaved(index, runs, _STRIDE)
        if run < runs:
            _resolve_run(run * _RUN, min(len(direction), (run + 1) * _RUN), direction, hair, goal_weight, body, share)


@njit(cache=True, fastmath=True, error_model="numpy")
def _resolve_run(
    first: int, last: int, direction: np.ndarray, hair: StrandArrays, goal_weight: np.ndarray, body: SurfaceArrays,
    share: float | np.floating,
) -> None:  # fmt: skip
    workspace = search_workspace()
    leaf = int(np.int64(0))  # a literal would be a type of its own, for which the search is compiled again
    for strand in range(first, last):
        px, py, pz = hair.root[strand, 0], hair.root[strand, 1], hair.root[strand, 2]
        for edge in range(direction.shape[1]):
            length, full = hair.length[strand, edge], hair.margin[strand, edge + 1]
            margin = min(share * full, full)  # hair that was designed inside the skin stays there
            t = direction[strand, edge]
            x, y, z = px + length * t[0], py + length * t[1], pz + length * t[2]
            distance, nx, ny, nz, found = distance_within(x, y, z, margin, leaf, body, workspace)
            if found >= 0 and goal_weight[strand, edge] == _ZERO:
                leaf = found
                push = min(max(margin - distance, _ZERO), _MOST_PUSH * length)
                if push > _ZERO:
                    # Not `pushed_edge`, which fast math sums in another order: an edge differs by up to 2e-5. The
                    # passes that follow amplify one unit in the last place to centimetres, for hair in contact can
                    # rest in many ways, so that drapes could no longer be compared with those of before.
                    vx, vy, vz = x + push * nx - px, y + push * ny - py, z + push * nz - pz
                    inverse = _ONE / max(np.sqrt(vx * vx + vy * vy + vz * vz), _TINY)
                    t[0], t[1], t[2] = inverse * vx, inverse * vy, inverse * vz
                    x, y, z = px + length * t[0], py + length * t[1], pz + length * t[2]
            px, py, pz = x, y, z
