"""The tests check the shapes in annotations of the package, and of each function for a while only."""

import pytest
import torch

from quaffure.geometry.polyline import arc_lengths
from tests import shape_checks

pytest.importorskip("beartype")


def test_wrong_shapes_are_refused_in_the_first_calls_of_a_file() -> None:
    wrong = torch.zeros(1, 1, 4, 3)
    with pytest.raises(Exception, match="arc_lengths"):
        arc_lengths(wrong)
    for _ in range(shape_checks.CHECKED_CALLS):
        arc_lengths(wrong[0])
    arc_lengths(wrong)
    shape_checks.restart()
    with pytest.raises(Exception, match="arc_lengths"):
        arc_lengths(wrong)
