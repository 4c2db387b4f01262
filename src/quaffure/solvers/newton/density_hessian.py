"""Products of the Hessian of Eq. 11 in double precision, from a list of the pairs that matter."""

import numpy as np
from jaxtyping import Float
from numba import njit, prange

from quaffure.solvers.newton.density_pairs import PressedPairs


def density_change(pairs: PressedPairs, step: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, " q"]:
    """First-order change of every density that has stiffness along a step [m], 0 of the others [kg/m^3].

    Vertices beyond those that `step` holds do not move.
    """
    change = np.empty(len(pairs.mass))
    _change(pairs, _padded(pairs, step), change)
    return change


def density_force(
    pairs: PressedPairs, pressure: Float[np.ndarray, " q"], moving: int | None = None
) -> Float[np.ndarray, "p 3"]:
    """Gradient [N] of an energy whose derivative by every density is `pressure` [J m^3/kg], by the first `moving`."""
    force = np.empty((len(pressure) if moving is None else moving, 3))
    _force(pairs, pressure, force)
    return force


def density_product(pairs: PressedPairs, step: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, "p 3"]:
    """The Hessian times a step [m] of those that move: [N]."""
    change, product, step_of_all = np.empty(len(pairs.mass)), np.empty_like(step), _padded(pairs, step)
    _change(pairs, step_of_all, change)
    change *= pairs.stiffness
    _multiply(pairs, change, step_of_all, product)
    return product


def density_blocks(pairs: PressedPairs, moving: int | None = None) -> Float[np.ndarray, "p 3 3"]:
    """Blocks of the Hessian on each of the first `moving` vertices [N/m]."""
    blocks = np.empty((len(pairs.mass) if moving is None else moving, 3, 3))
    _blocks(pairs, blocks)
    return blocks


def _padded(pairs: PressedPairs, step: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, "q 3"]:
    if len(step) == len(pairs.mass):
        return step
    padded = np.zeros((len(pairs.mass), 3))
    padded[: len(step)] = step
    return padded


@njit(cache=True, parallel=True, fastmath=True)
def _force(pairs: PressedPairs, pressure: np.ndarray, force: np.ndarray) -> None:
    first, others, gradients, _, _, mass, _ = pairs
    for row in prange(len(force)):
        fx, fy, fz = 0.0, 0.0, 0.0
        own_mass, own_pressure = mass[row], pressure[row]
        for at in range(first[row], first[row + 1]):
            other = others[at]
            push = own_pressure * mass[other] + pressure[other] * own_mass
            fx += push * gradients[at, 0]
            fy += push * gradients[at, 1]
            fz += push * gradients[at, 2]
        force[row, 0], force[row, 1], force[row, 2] = fx, fy, fz


@njit(cache=True, parallel=True, fastmath=True)
def _change(pairs: PressedPairs, step: np.ndarray, change: np.ndarray) -> None:
    first, others, gradients, _, _, mass, stiffness = pairs
    for row in prange(len(mass)):
        change[row] = 0.0
        if stiffness[row] <= 0.0:
            continue
        total = 0.0
        sx, sy, sz = step[row, 0], step[row, 1], step[row, 2]
        for at in range(first[row], first[row + 1]):
            other = others[at]
            total += mass[other] * (
                gradients[at, 0] * (sx - step[other, 0])
                + gradients[at, 1] * (sy - step[other, 1])
                + gradients[at, 2] * (sz - step[other, 2])
            )
        change[row] = total


@njit(cache=True, parallel=True, fastmath=True)
def _multiply(pairs: PressedPairs, change: np.ndarray, step: np.ndarray, product: np.ndarray) -> None:
    first, others, gradients, across, along, mass, _ = pairs
    for row in prange(len(product)):
        fx, fy, fz = 0.0, 0.0, 0.0
        sx, sy, sz = step[row, 0], step[row, 1], step[row, 2]
        own_mass, own_change = mass[row], change[row]
        for at in range(first[row], first[row + 1]):
            other = others[at]
            dx, dy, dz = sx - step[other, 0], sy - step[other, 1], sz - step[other, 2]
            gx, gy, gz = gradients[at, 0], gradients[at, 1], gradients[at, 2]
            push = own_change * mass[other] + change[other] * own_mass
            push += along[at] * (gx * dx + gy * dy + gz * dz)
            fx += push * gx + across[at] * dx
            fy += push * gy + across[at] * dy
            fz += push * gz + across[at] * dz
        product[row, 0], product[row, 1], product[row, 2] = fx, fy, fz


@njit(cache=True, parallel=True, fastmath=True)
def _blocks(pairs: PressedPairs, blocks: np.ndarray) -> None:
    first, others, gradients, across, along, mass, stiffness = pairs
    for row in prange(len(blocks)):
        block = np.zeros((3, 3))
        ox, oy, oz = 0.0, 0.0, 0.0
        for at in range(first[row], first[row + 1]):
            other = others[at]
            gx, gy, gz = gradients[at, 0], gradients[at, 1], gradients[at, 2]
            ox += mass[other] * gx
            oy += mass[other] * gy
            oz += mass[other] * gz
            weight = stiffness[other] * mass[row] * mass[row] + along[at]
            block[0, 0] += weight * gx * gx + across[at]
            block[0, 1] += weight * gx * gy
            block[0, 2] += weight * gx * gz
            block[1, 1] += weight * gy * gy + across[at]
            block[1, 2] += weight * gy * gz
            block[2, 2] += weight * gz * gz + across[at]
        own = stiffness[row]
        block[0, 0] += own * ox * ox
        block[0, 1] += own * ox * oy
        block[0, 2] += own * ox * oz
        block[1, 1] += own * oy * oy
        block[1, 2] += own * oy * oz
        block[2, 2] += own * oz * oz
        block[1, 0], block[2, 0], block[2, 1] = block[0, 1], block[0, 2], block[1, 2]
        blocks[row] = block
