"""The step between the ends of two passes, for strands that swing."""

import numpy as np

from quaffure.solvers.swings import Pass, between_swings


def _turned(*angles: float) -> np.ndarray:
    """One strand an angle, of three edges in a plane [rad]."""
    edges = np.stack([np.sin(angles), np.zeros(len(angles)), np.cos(angles)], axis=-1)
    return np.repeat(edges[:, None], 3, axis=1)


def test_a_linear_swing_ends_at_its_rest() -> None:
    """A pass that multiplies the angle from rest by -r: the secant finds zero, but goes no farther than the middle."""
    angle, shares = 1e-3, np.array([0.2, 0.5, 0.9, 1.5])
    begin, first, second = (_turned(*(angle * (-shares) ** power)) for power in (0, 1, 2))
    swinging, direction = between_swings(Pass(second, second - first, 1), Pass(first, first - begin, 0))
    np.testing.assert_array_equal(swinging, range(4))
    middle = 0.5 * angle * (shares[3] ** 2 - shares[3])
    np.testing.assert_allclose(direction[..., 0], np.repeat([[0.0], [0.0], [0.0], [middle]], 3, axis=1), atol=1e-8)
    np.testing.assert_allclose(np.linalg.norm(direction, axis=-1), 1.0)


def test_strands_that_go_on_are_left_alone() -> None:
    begin, first, second = _turned(0.3, 0.3), _turned(0.2, 0.2), _turned(0.15, 0.25)
    swinging, direction = between_swings(Pass(second, second - first, 1), Pass(first, first - begin, 0))
    np.testing.assert_array_equal(swinging, [1])
    assert 0.2 < np.arcsin(direction[0, 0, 0]) < 0.25
