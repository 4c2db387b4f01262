from itertools import pairwise

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from quaffure.geometry.cell_list import fixed_radius_pairs, fixed_radius_pairs_reference, interleaved


def as_set(pairs: torch.Tensor) -> set[tuple[int, int]]:
    found = list(map(tuple, pairs.T.tolist()))
    assert len(found) == len(set(found))
    return set(found)


@settings(deadline=None, max_examples=25)
@given(count=st.integers(1, 300), radius=st.floats(0.005, 0.5), stretch=st.floats(0.1, 50), seed=st.integers(0, 99))
def test_kernel_and_twin_find_the_same_pairs(count: int, radius: float, stretch: float, seed: int) -> None:
    points = torch.rand(count, 3, generator=torch.Generator().manual_seed(seed)) * torch.tensor([1.0, 0.3, stretch])
    assert as_set(fixed_radius_pairs(points, radius)) == as_set(fixed_radius_pairs_reference(points, radius))


def test_one_stray_point_does_not_fill_the_memory() -> None:
    points = torch.cat([torch.rand(100, 3) * 0.1, torch.tensor([[1e4, -1e4, 1e4]])])
    pairs = fixed_radius_pairs(points, 0.01)
    assert as_set(pairs) == as_set(fixed_radius_pairs_reference(points, 0.01))


def test_huge_coordinates_neither_crash_nor_pair() -> None:
    points = torch.tensor([[1e25, -1e25, 1e25], [-1e25, 1e25, -1e25], [0.0, 0.0, 0.0], [0.0, 0.0, 0.005]])
    assert as_set(fixed_radius_pairs(points, 0.01)) == {(2, 3)}


def test_points_in_one_place_are_a_pair() -> None:
    assert as_set(fixed_radius_pairs(torch.zeros(3, 3), 0.1)) == {(0, 1), (0, 2), (1, 2)}


@pytest.mark.cuda
def test_twin_finds_the_same_pairs_on_cuda() -> None:
    points = torch.rand(300, 3, generator=torch.Generator().manual_seed(0))
    assert as_set(fixed_radius_pairs(points.cuda(), 0.2).cpu()) == as_set(fixed_radius_pairs(points, 0.2))


@pytest.mark.parametrize(("count", "threads"), [(0, 2), (1, 1), (1, 8), (7, 2), (8, 2), (9, 4), (1000, 64)])
def test_every_item_is_dealt_once(count: int, threads: int) -> None:
    items = [interleaved(index, count, threads) for index in range(count + threads)]
    assert sorted(item for item in items if item < count) == list(range(count))
    half = [item for item in items[: -(-count // threads)] if item < count]
    assert threads == 1 or all(second - first == threads for first, second in pairwise(half))
