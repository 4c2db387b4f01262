"""What the next model is told after a step, and the line search."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from quaffure.drapers.newton_descent import LEAST_DAMPING, MOST_DAMPING, SHORTER, Step, Trust, line_search
from quaffure.drapers.newton_system import Point


def tried(trials: int = 1, agreement: float = 1.0, is_bent: bool = False, rise: float = 0.0) -> Step:
    nowhere = Point(*(np.empty(0) for _ in range(4)), None, np.empty(0), 0.0)  # type: ignore[arg-type]
    return Step(nowhere, trials, np.array([[rise]]), is_bent, agreement)


def test_trust_in_the_model_follows_how_the_step_went() -> None:
    half = Trust(np.array([[0.02]]), exactness=0.5, damping=1.0)

    def exactness(step: Step, relative: float = 0.0) -> float:
        return half.after(relative, step).exactness

    assert exactness(tried()) > exactness(tried(agreement=0.7)) > 0.5
    assert exactness(tried(agreement=1.5)) == exactness(tried(agreement=0.7))
    assert exactness(tried(agreement=0.4)) == exactness(tried(trials=2, agreement=0.0)) == 0.5
    assert exactness(tried(is_bent=True, agreement=0.0)) == exactness(tried(trials=3, agreement=0.0)) < 0.5
    assert exactness(tried(trials=7, agreement=0.0)) < exactness(tried(trials=3, agreement=0.0))
    assert exactness(tried(), relative=0.9) == pytest.approx(0.1)
    assert exactness(tried(), relative=5.0) == 0.0
    never_sure = half
    for _ in range(50):
        never_sure = never_sure.after(0.0, tried())
    assert 1.0 - 1e-6 < never_sure.exactness <= 1.0


def test_steps_are_damped_where_even_the_convex_model_leads_too_far() -> None:
    convex, failed = Trust(np.array([[0.02]])), tried(trials=12, agreement=0.0)
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
    trust = Trust(np.array([[0.02]]))
    assert trust.after(0.0, tried(rise=0.1)).slack == pytest.approx(0.07)
    assert trust.after(0.0, tried(rise=-0.1)).slack == pytest.approx(0.01)


def test_a_shortened_step_promises_what_its_own_strands_do(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two strands: one falls by much and is to blame, the other rises by little; shortening the first alone fails."""
    slope, energies = np.array([-1.0, 0.5]), []
    model = SimpleNamespace(
        gradient=slope[:, None, None] * np.ones((2, 1, 1)),
        point=SimpleNamespace(energy=0.0, excess=np.zeros((2, 1))),
        forecast=lambda step: SimpleNamespace(surprise=lambda start, length, reached: np.array([1.0, 0.0])),
    )

    def moved(system: object, model: object, step: np.ndarray, length: np.ndarray) -> SimpleNamespace:
        energies.append(length.copy())
        return SimpleNamespace(energy=float((length * slope).sum() + 2 * length[0]), excess=np.zeros((2, 1)))

    monkeypatch.setattr("quaffure.drapers.newton_descent._moved", moved)
    line_search(None, model, np.ones((2, 1, 1)), False)  # type: ignore[arg-type]
    assert [tuple(length) for length in energies[:3]] == [(1, 1), (0.4, 1), (0.4**2, 1)]
    assert energies[6] == pytest.approx(SHORTER**6 * np.ones(2))
    assert energies[-1] == pytest.approx(SHORTER**11 * np.ones(2))
