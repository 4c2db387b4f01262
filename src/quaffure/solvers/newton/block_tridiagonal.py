"""Symmetric block-tridiagonal systems of strands, one 3 x 3 block a vertex: factored and solved.

Vertex 0 of a strand is held fixed and takes no part. The block that couples vertex `i` to `i + 1` is symmetric.
Block elimination along a chain is Golub and Van Loan, Matrix Computations (2013), section 4.5.
"""

import numpy as np
from numba import njit, prange

FIRST_SHIFT = 0.01
"""What a pivot that is not positive definite is raised by at first, of its size."""


@njit(cache=True, inline="always")
def invert_definite(matrix: np.ndarray, inverse: np.ndarray) -> bool:
    """Inverse of a symmetric 3 x 3 matrix; False, and nothing useful written, where it is not positive definite."""
    a, b, c = matrix[0, 0], matrix[0, 1], matrix[0, 2]
    d, e, f = matrix[1, 1], matrix[1, 2], matrix[2, 2]
    xx, xy, xz = d * f - e * e, c * e - b * f, b * e - c * d
    determinant = a * xx + b * xy + c * xz
    minor = a * d - b * b
    # A pivot that cancels to rounding is no pivot.
    if not (a > 0.0 and minor > 1e-12 * a * abs(d) and determinant > 1e-12 * minor * abs(f)):
        return False
    scale = 1.0 / determinant
    inverse[0, 0] = xx * scale
    inverse[0, 1] = inverse[1, 0] = xy * scale
    inverse[0, 2] = inverse[2, 0] = xz * scale
    inverse[1, 1] = (a * f - c * c) * scale
    inverse[1, 2] = inverse[2, 1] = (b * c - a * e) * scale
    inverse[2, 2] = minor * scale
    return True


@njit(cache=True)
def factor_strand(diagonal: np.ndarray, coupling: np.ndarray, pivot_inverse: np.ndarray) -> bool:
    """Eliminate one strand from root to tip; False where the matrix is not positive definite.

    The factors are then those of a matrix near by that is: pivots that are not positive definite are raised.

    Args:
        diagonal: [n, 3, 3] blocks of the vertices.
        coupling: [n - 1, 3, 3] blocks between each vertex and the next; the first is not read.
        pivot_inverse: [n, 3, 3], filled with the inverses of the pivots; zero at the root.
    """
    pivot, definite = np.empty((3, 3)), True
    pivot_inverse[0] = 0.0
    for vertex in range(1, len(diagonal)):
        pivot[:] = diagonal[vertex]
        if vertex > 1:
            before, inverse = coupling[vertex - 1], pivot_inverse[vertex - 1]
            for row in range(3):
                p = before[row, 0] * inverse[0, 0] + before[row, 1] * inverse[1, 0] + before[row, 2] * inverse[2, 0]
                q = before[row, 0] * inverse[0, 1] + before[row, 1] * inverse[1, 1] + before[row, 2] * inverse[2, 1]
                r = before[row, 0] * inverse[0, 2] + before[row, 1] * inverse[1, 2] + before[row, 2] * inverse[2, 2]
                for column in range(3):
                    pivot[row, column] -= p * before[0, column] + q * before[1, column] + r * before[2, column]
        shift = FIRST_SHIFT * (abs(pivot[0, 0]) + abs(pivot[1, 1]) + abs(pivot[2, 2])) + 1e-12
        while not invert_definite(pivot, pivot_inverse[vertex]):
            definite = False
            if not shift < np.inf:
                # The matrix is not finite and no shift would help. The vertex stays where it is.
                pivot_inverse[vertex] = 0.0
                break
            for axis in range(3):
                pivot[axis, axis] += shift
            shift *= 2.0
    return definite


@njit(cache=True, inline="always")
def _add_product(matrix: np.ndarray, vector: np.ndarray, sign: float, out: np.ndarray) -> None:
    x, y, z = sign * vector[0], sign * vector[1], sign * vector[2]
    for row in range(3):
        out[row] += matrix[row, 0] * x + matrix[row, 1] * y + matrix[row, 2] * z


@njit(cache=True)
def solve_strand(coupling: np.ndarray, pivot_inverse: np.ndarray, right: np.ndarray, solution: np.ndarray) -> None:
    """Solve one strand by its factors, for a right-hand side [n, 3]; zero at the root."""
    count = len(right)
    scaled = np.zeros(3)
    solution[0] = 0.0
    for vertex in range(1, count):
        solution[vertex] = right[vertex]
        if vertex > 1:
            _add_product(coupling[vertex - 1], scaled, -1.0, solution[vertex])
        scaled[:] = 0.0
        _add_product(pivot_inverse[vertex], solution[vertex], 1.0, scaled)
    for vertex in range(count - 1, 0, -1):
        if vertex < count - 1:
            _add_product(coupling[vertex], solution[vertex + 1], -1.0, solution[vertex])
        scaled[:] = 0.0
        _add_product(pivot_inverse[vertex], solution[vertex], 1.0, scaled)
        solution[vertex] = scaled


@njit(cache=True, parallel=True)
def solve_strands(coupling: np.ndarray, pivot_inverse: np.ndarray, right: np.ndarray, solution: np.ndarray) -> None:
    """`solve_strand` for every strand [s, n, 3]."""
    for strand in prange(len(right)):
        solve_strand(coupling[strand], pivot_inverse[strand], right[strand], solution[strand])
