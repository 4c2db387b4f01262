"""What the next model is told after a step, and the line search."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from quaffure.solvers.newton.density_particles import density_particles
from quaffure.solvers.newton.newton_descent import (
    LEAST_DAMPING,
    MOST_DAMPING,
    SHORTER,
    SUFFICIENT,
    Step,
    TrustRegionState,
    line_search,
)
from quaffure.solvers.newton.newton_system import NewtonSystem, Point, QuadraticModel


def tried(trials: int = 1, agreement: float = 1.0, has_negative_curvature: bool = False, rise: float = 0.0) -> Step:
    nowhere = Point(*(np.empty(0) for _ in range(4)), None, np.empty(0), 0.0)  # type: ignore[arg-type]
    return Step(nowhere, trials, np.array([[rise]]), has_negative_curvature, agreement)


def test_trust_in_the_model_follows_how_the_step_went() -> None:
    half = TrustRegionState(np.array([[0.02]]), exactness=0.5, damping=1.0)

    def exactness(step: Step, relative: float = 0.0) -> float:
        return half.after(relative, step).exactness

    assert exactness(tried()) > exactness(tried(agreement=0.7)) > 0.5
    assert exactness(tried(agreement=1.5)) == exactness(tried(agreement=0.7))
    assert exactness(tried(agreement=0.4)) == exactness(tried(trials=2, agreement=0.0)) == 0.5
    assert (
        exactness(tried(has_negative_curvature=True, agreement=0.0)) == exactness(tried(trials=3, agreement=0.0)) < 0.5
    )
    assert exactness(tried(trials=7, agreement=0.0)) < exactness(tried(trials=3, agreement=0.0))
    assert exactness(tried(), relative=0.9) == pytest.approx(0.1)
    assert exactness(tried(), relative=5.0) == 0.0
    never_sure = half
    for _ in range(50):
        never_sure = never_sure.after(0.0, tried())
    assert 1.0 - 1e-6 < never_sure.exactness <= 1.0


def test_steps_are_damped_where_even_the_convex_model_leads_too_far() -> None:
    convex, failed = TrustRegionState(np.array([[0.02]])), tried(trials=12, agreement=0.0)
    first = convex.after(0.0, failed)
    assert first.damping == LEAST_DAMPING
    assert first.after(0.0, failed).damping == 4 * LEAST_DAMPING
    assert first.after(0.0, tried(trials=4, agreement=0.0)).damping == LEAST_DAMPING
    assert first.after(0.0, tried()).damping == 0.0
    assert replace(convex, exactness=0.5).after(0.0, failed).damping == 0.0
    damped = convex
    for _ in range(9):
        damped = damped.after(0.0, failed)
    assert damped.damping > MOST_DAMPING


def test_hair_that_came_closer_resists_sooner() -> None:
    trust = TrustRegionState(np.array([[0.02]]))
    assert trust.after(0.0, tried(rise=0.1)).slack == pytest.approx(0.07)
    assert trust.after(0.0, tried(rise=-0.1)).slack == pytest.approx(0.01)


@pytest.mark.parametrize("other_slope", [0.5, -0.5])
def test_a_shortened_step_leads_downhill(monkeypatch: pytest.MonkeyPatch, other_slope: float) -> None:
    """Two strands, of which the first is to blame: shortened alone it leaves a step uphill where the other rises."""
    slope = np.array([-1.0, other_slope])
    lengths: list[np.ndarray] = []
    model, system = object.__new__(QuadraticModel), object.__new__(NewtonSystem)
    predicted = SimpleNamespace(model_error=lambda start, length, reached: np.array([1.0, 0.0]))
    gradient = np.broadcast_to(slope[:, None, None], (2, 1, 3)) / 3
    model.__dict__.update(gradient=gradient, point=at(0.0), predicted=lambda step: predicted)

    def moved(system: NewtonSystem, model: QuadraticModel, step: np.ndarray, length: np.ndarray) -> Point:
        lengths.append(length.copy())
        return at(1.0)

    monkeypatch.setattr("quaffure.solvers.newton.newton_descent._moved", moved)
    step = line_search(system, model, np.ones((2, 1, 3)), False)
    assert step.agreement == 0
    assert [tuple(length) for length in lengths[:3]] == [(1, 1), (SHORTER, 1), (SHORTER**2, 1)]
    assert all((length * slope).sum() < 0 for length in lengths[6:])
    assert lengths[6] == pytest.approx(SHORTER * np.array([SHORTER**5, 1 if other_slope < 0 else SHORTER**5]))
    assert lengths[-1] == pytest.approx(SHORTER**5 * lengths[6])


def test_a_step_must_bring_a_part_of_what_its_own_length_promises(monkeypatch: pytest.MonkeyPatch) -> None:
    """The second strand promises all, the first is cut short: what remains is still the whole promise."""
    slope = np.array([-0.001, -1.0])
    energies = iter([0.5, -0.08, -0.2])
    model, system = object.__new__(QuadraticModel), object.__new__(NewtonSystem)
    predicted = SimpleNamespace(model_error=lambda start, length, reached: np.array([1.0, 0.0]))
    gradient = np.broadcast_to(slope[:, None, None], (2, 1, 3)) / 3
    model.__dict__.update(gradient=gradient, point=at(0.0), predicted=lambda step: predicted)
    monkeypatch.setattr("quaffure.solvers.newton.newton_descent._moved", lambda *arguments: at(next(energies)))
    # By the mean of the lengths, 0.7, the second trial would do.
    assert SUFFICIENT * 0.7 < 0.08 < SUFFICIENT
    assert line_search(system, model, np.ones((2, 1, 3)), False).trials == 3


def at(energy: float) -> Point:
    """Two strands of one vertex."""
    nothing = np.zeros((2, 1))
    particles = density_particles(np.zeros((2, 3)), np.ones(2), 1.0)
    return Point(np.zeros((2, 1, 3)), np.zeros(2), nothing, nothing, particles, np.empty(0), energy)
