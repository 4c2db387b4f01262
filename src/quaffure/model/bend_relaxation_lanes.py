"""Compiled twin of `quaffure.model.bend_relaxation`: a strand in each lane of the processor's vectors, float32."""

import numpy as np
from numba import njit

from quaffure.geometry.mls_kernels import FAST, LANES
from quaffure.model import free_rod_lanes as rod
from quaffure.model.bend_relaxation_kernel import bend_before, eliminated, turned

# Rows of what is kept of an edge: bend, and theta_i = follows theta_(i-1) - shift.
_BEND, _FOLLOWS, _SHIFT = 0, 3, 4
# Rows of what is passed on: stiffness and slope of the quadratic function beyond.
_STIFFNESS, _SLOPE = 0, 1
_ZERO, _ONE = np.float32(0.0), np.float32(1.0)


@njit(cache=True, fastmath=FAST, error_model="numpy")
def relax_bends(inputs: np.ndarray, relaxation: float | np.floating, state: np.ndarray, passed: np.ndarray) -> None:
    """Relax the bends of the directions in `inputs` relative to the free ones there.

    Args:
        inputs: [edge, `free_rod_lanes.INPUTS`, lane].
        relaxation: r, above 0.
        state, passed: workspaces of `free_rod_lanes.relax`.
    """
    passed[0] = _ONE
    passed[1:4] = _ZERO
    for edge in range(len(inputs)):
        _bend(inputs[edge], state[edge], passed)
    passed[:4] = _ZERO
    per_relaxation = _ONE / relaxation
    for edge in range(len(inputs) - 1, -1, -1):
        _eliminate(inputs[edge], per_relaxation, state[edge], passed)
    passed[:3] = _ZERO
    for edge in range(len(inputs)):
        _substitute(inputs[edge], state[edge], passed)


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _bend(row: np.ndarray, own: np.ndarray, rotation: np.ndarray) -> None:
    """Bend before an edge; `rotation` is that of the edge before from its free direction, and then its own."""
    for i in range(LANES):
        before = rotation[0, i], rotation[1, i], rotation[2, i], rotation[3, i]
        free = row[rod.FREE, i], row[rod.FREE + 1, i], row[rod.FREE + 2, i]
        direction = row[rod.DIRECTION, i], row[rod.DIRECTION + 1, i], row[rod.DIRECTION + 2, i]
        bend, whole = bend_before(before, free, direction)
        own[_BEND, i], own[_BEND + 1, i], own[_BEND + 2, i] = bend
        rotation[0, i], rotation[1, i], rotation[2, i], rotation[3, i] = whole


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _eliminate(row: np.ndarray, per_relaxation: float | np.floating, own: np.ndarray, passed: np.ndarray) -> None:
    """Take an edge into the quadratic function in `passed`, and eliminate its rotation."""
    for i in range(LANES):
        joint = row[rod.BENDING, i]
        stiffness = joint * per_relaxation + row[rod.GOAL, i] + passed[_STIFFNESS, i]
        bend = own[_BEND, i], own[_BEND + 1, i], own[_BEND + 2, i]
        slope = passed[_SLOPE, i], passed[_SLOPE + 1, i], passed[_SLOPE + 2, i]
        follows, shift, slope = eliminated(bend, slope, joint, stiffness)
        own[_FOLLOWS, i], passed[_STIFFNESS, i] = follows, follows * stiffness
        own[_SHIFT, i], own[_SHIFT + 1, i], own[_SHIFT + 2, i] = shift
        passed[_SLOPE, i], passed[_SLOPE + 1, i], passed[_SLOPE + 2, i] = slope


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _substitute(row: np.ndarray, own: np.ndarray, theta: np.ndarray) -> None:
    """Rotate an edge; `theta` holds the rotation of the edge before, and then its own."""
    for i in range(LANES):
        shift = own[_SHIFT, i], own[_SHIFT + 1, i], own[_SHIFT + 2, i]
        direction = row[rod.DIRECTION, i], row[rod.DIRECTION + 1, i], row[rod.DIRECTION + 2, i]
        before = theta[0, i], theta[1, i], theta[2, i]
        rotation, direction = turned(own[_FOLLOWS, i], shift, before, direction)
        theta[0, i], theta[1, i], theta[2, i] = rotation
        row[rod.DIRECTION, i], row[rod.DIRECTION + 1, i], row[rod.DIRECTION + 2, i] = direction
