"""The examples run, do what their pages say, and stay as short as the pages promise."""

from collections.abc import Callable
from pathlib import Path

import pytest

from examples import own_energy_term, own_network, own_solver

EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.stem)
def test_an_example_is_one_short_file(path: Path) -> None:
    assert len(path.read_text(encoding="utf-8").splitlines()) < 60
    assert f"examples/{path.name}" in (EXAMPLES.parent / "docs" / "extend.md").read_text(encoding="utf-8")


def test_a_term_of_ones_own_moves_the_hair() -> None:
    found = own_energy_term.main(strands=60, steps=30)
    assert found["with"] < 0.9 * found["without"]


def test_a_solver_of_ones_own_lowers_the_energy() -> None:
    found = own_solver.main()
    assert found["momentum"] < 0.6 * found["posed"]


def test_a_network_of_ones_own_is_trained_and_drapes() -> None:
    losses = own_network.main(steps=2)
    assert len(losses) == 2


@pytest.mark.parametrize("main", [own_energy_term.main, own_network.main, own_solver.main])
def test_each_says_what_it_returns(main: Callable[..., object]) -> None:
    assert main.__doc__
