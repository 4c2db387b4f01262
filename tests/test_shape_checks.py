"""The tests check the shapes in annotations of the package, in the first calls of a function and in some later ones."""

import pytest
import torch

from quaffure.geometry.polyline import arc_lengths
from tests import shape_checks

pytest.importorskip("beartype")


def test_wrong_shapes_are_refused_in_the_first_calls_of_a_file_and_in_some_later_ones() -> None:
    wrong = torch.zeros(1, 1, 4, 3)
    with pytest.raises(Exception, match="arc_lengths"):
        arc_lengths(wrong)
    for _ in range(shape_checks.CHECKED_CALLS):
        arc_lengths(wrong[0])
    arc_lengths(wrong)
    with pytest.raises(Exception, match="arc_lengths"):
        arc_lengths(wrong)
    shape_checks.restart()
    with pytest.raises(Exception, match="arc_lengths"):
        arc_lengths(wrong)
