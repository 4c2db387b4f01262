"""The criterion of rest of benchmarks/peers, by which programs with other energies are compared."""

import numpy as np
import pytest

from benchmarks.peers.rest import Trace, arrival, extrapolated


def trace(*distances: float) -> Trace:
    """One vertex that far from the origin [m]; it ends there."""
    states = np.zeros((len(distances) + 1, 1, 1, 3))
    states[:-1, 0, 0, 0] = distances
    return Trace(np.arange(len(states), dtype=float), states)


def test_arrives_when_it_stays_within_the_tolerance() -> None:
    assert arrival(trace(0.1, 0.01, 5e-4, 2e-4)) == 2


def test_a_swing_through_the_end_is_no_arrival() -> None:
    assert arrival(trace(0.1, 0.0, -0.02, 5e-4)) == 3


def test_a_state_that_blew_up_is_not_at_rest() -> None:
    assert arrival(trace(5e-4, np.nan, 5e-4)) == 2


def test_a_run_that_ends_blown_up_has_no_rest() -> None:
    with pytest.raises(ArithmeticError, match="blew up"):
        arrival(Trace(np.arange(2.0), np.array([0.0, np.nan])[:, None, None, None] * np.ones((1, 1, 3))))


def test_what_never_moves_rests_from_the_start() -> None:
    assert arrival(trace(0.0, 0.0)) == 0


def test_the_mean_over_vertices_counts() -> None:
    states = np.zeros((2, 2, 5, 3))
    states[0, 1, 4, 2] = 5e-3
    assert arrival(Trace(np.arange(2.0), states), tolerance=4e-4) == 1
    assert arrival(Trace(np.arange(2.0), states), tolerance=6e-4) == 0


@pytest.mark.parametrize(("growth", "expected"), [(1.0, 3.0), (2.0, 60.0), (4.0, 1200.0)])
def test_time_grows_by_the_power_that_twice_the_strands_show(growth: float, expected: float) -> None:
    assert extrapolated(3.0, growth, 20.0) == pytest.approx(expected)
