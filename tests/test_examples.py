"""The examples run, do what their pages say, and stay as short as the pages promise."""

from collections.abc import Callable
from pathlib import Path

import pytest

from examples import (
    clip_and_picture,
    gradient_in_pose,
    many_drapes,
    own_energy_term,
    own_groom,
    own_network,
    own_solver,
    stiffness_wind_ties,
)

EXAMPLES = Path(__file__).parents[1] / "examples"
PAGES = [EXAMPLES.parent / "docs" / page for page in ("extend.md", "examples.md")]


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.stem)
def test_an_example_is_one_short_file(path: Path) -> None:
    assert len(path.read_text(encoding="utf-8").splitlines()) < 60
    assert any(f"examples/{path.name}" in page.read_text(encoding="utf-8") for page in PAGES)


def test_a_term_of_ones_own_moves_the_hair() -> None:
    found = own_energy_term.main(strands=60, steps=30)
    assert found["with"] < 0.9 * found["without"]


def test_a_solver_of_ones_own_lowers_the_energy() -> None:
    found = own_solver.main()
    assert found["momentum"] < 0.6 * found["posed"]


def test_a_network_of_ones_own_is_trained_and_drapes() -> None:
    losses = own_network.main(steps=2)
    assert len(losses) == 2


def test_a_clip_is_draped_written_and_drawn(tmp_path: Path) -> None:
    for package in ("moderngl", "PIL"):
        pytest.importorskip(package)
    hair = clip_and_picture.main(tmp_path, frames="0:2", guides=100)
    assert len(hair) == 2
    assert {path.suffix for path in tmp_path.iterdir()} == {".npz", ".glb", ".png"}


@pytest.mark.slow
def test_strands_of_an_array_become_a_groom(tmp_path: Path) -> None:
    groom = own_groom.main(tmp_path, count=300)
    assert 150 < len(groom) <= 300
    assert 0.04 < float(groom.strand_lengths.mean()) < 0.1


@pytest.mark.slow
def test_the_gradient_in_the_pose_is_that_of_differences() -> None:
    found = gradient_in_pose.main(strands=40)
    assert abs(found["differences"]) > 0.01
    assert found["autograd"] == pytest.approx(found["differences"], rel=1e-4)


def test_loadings_and_clips_move_the_hair_the_right_way() -> None:
    found = stiffness_wind_ties.main(strands=200)
    assert found["wind"] > 0.02
    assert abs(found["fine"] - found["coarse"]) > 0.01
    assert abs(found["held"]) > 0.005


@pytest.mark.slow
def test_many_characters_are_draped() -> None:
    assert many_drapes.main(count=3, guides=60)["characters"] == 3


@pytest.mark.parametrize("main", [own_energy_term.main, own_network.main, own_solver.main])
def test_each_says_what_it_returns(main: Callable[..., object]) -> None:
    assert main.__doc__
