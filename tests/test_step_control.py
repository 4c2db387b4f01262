"""What slows strands that reverse."""

import numpy as np

from quaffure.solvers.step_control import LEAST_SHARE, OscillationDamping, StepHistory, secant_shares


def test_a_linear_motion_that_reverses_ends_at_its_rest() -> None:
    """A pass that multiplies the distance from rest by -r steps by -(1 + r) of it: the secant finds zero."""
    factors = np.array([0.2, 0.5, 0.9, 9.0])
    unit = np.random.default_rng(0).standard_normal((4, 3, 3))
    distance, before = -factors, -(1 + factors)
    step = -(1 + factors) * distance
    shares = secant_shares(step[:, None, None] * unit, before[:, None, None] * unit)
    np.testing.assert_allclose((distance + shares * step)[:3], 0.0, atol=1e-12)
    assert shares[3] == LEAST_SHARE


def test_strands_that_go_on_take_the_whole_step() -> None:
    step = np.random.default_rng(0).standard_normal((2, 3, 3)).astype(np.float32)
    shares = secant_shares(step, np.stack([0.3 * step[0], -0.3 * step[1]]))
    assert shares[0] == 1
    assert 0.2 < shares[1] < 0.3


def test_a_strand_at_rest_takes_its_step() -> None:
    step = np.zeros((1, 3, 3), np.float32)
    assert secant_shares(step, step)[0] == 1


def test_a_forgotten_history_shortens_and_damps_nothing_but_keeps_its_damping() -> None:
    step = np.random.default_rng(0).standard_normal((2, 3, 3)).astype(np.float32)
    rule = OscillationDamping()
    history = StepHistory(2, rule)
    np.testing.assert_array_equal(history.shortened(step), step)
    history.record(step)
    np.testing.assert_allclose(history.shortened(-step), -0.5 * step, rtol=1e-6)
    history.record(-step)
    np.testing.assert_array_equal(history.damping, np.full(2, rule.first, np.float32))
    history.forget()
    np.testing.assert_array_equal(history.shortened(step), step)
    history.record(step)
    np.testing.assert_array_equal(history.damping, np.full(2, rule.first, np.float32))
