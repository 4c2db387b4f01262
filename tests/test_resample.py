import numpy as np
import pytest

from quaffure import InputError
from quaffure.hair import Strands, concatenate_strands, polyline_lengths, resample_by_arc_length
from quaffure.hair.resample import without_degenerate


def ragged(*polylines: list[list[float]]) -> Strands:
    arrays = [np.array(line, dtype=np.float32) for line in polylines]
    return Strands(np.concatenate(arrays), np.array([len(line) for line in arrays]), "test")


STRAIGHT = [[1.0, 2.0, 3.0], [1.0, 2.0, 2.9], [1.0, 2.0, 2.0], [1.0, 2.0, 0.0]]
CORNER = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 3.0, 0.0]]


def test_straight_strands_stay_exact_and_become_even() -> None:
    result = resample_by_arc_length(ragged(STRAIGHT, CORNER), 7)
    assert np.allclose(result[0, :, 2], np.linspace(3, 0, 7), atol=1e-6)
    assert np.array_equal(result[0, :, :2], np.tile(np.float32([1, 2]), (7, 1)))


def test_vertices_lie_at_equal_arc_length() -> None:
    result = resample_by_arc_length(ragged(STRAIGHT, CORNER), 5)[1]
    assert np.allclose(result, [[0, 0, 0], [1, 0, 0], [1, 1, 0], [1, 2, 0], [1, 3, 0]], atol=1e-6)


def test_ends_are_kept_whatever_the_counts() -> None:
    generator = np.random.default_rng(0)
    lines = [np.cumsum(generator.normal(size=(count, 3)), axis=0).tolist() for count in (2, 5, 90)]
    strands = ragged(*lines)
    result = resample_by_arc_length(strands)
    assert result.shape == (3, 24, 3)
    assert np.array_equal(result[:, 0], strands.roots)
    assert np.array_equal(result[:, -1], strands.points[strands.starts + strands.counts - 1])
    assert (np.linalg.norm(np.diff(result, axis=1), axis=2).sum(1) <= polyline_lengths(strands) * (1 + 1e-6)).all()


def test_repeated_points_do_no_harm() -> None:
    result = resample_by_arc_length(ragged([CORNER[0], CORNER[0], CORNER[1], CORNER[1], CORNER[2], CORNER[2]]), 5)[0]
    assert np.allclose(result, [[0, 0, 0], [1, 0, 0], [1, 1, 0], [1, 2, 0], [1, 3, 0]], atol=1e-6)


def test_strands_without_length_are_counted_or_refused() -> None:
    dot = [[5.0, 5.0, 5.0], [5.0, 5.0, 5.0]]
    kept, dropped = without_degenerate(ragged(CORNER, dot, STRAIGHT))
    assert dropped == 1
    assert kept.counts.tolist() == [3, 4]
    assert np.array_equal(kept.roots, np.float32([[0, 0, 0], [1, 2, 3]]))
    with pytest.raises(InputError, match="zero length"):
        resample_by_arc_length(ragged(CORNER, dot))
    with pytest.raises(InputError, match="zero length"):
        without_degenerate(ragged(dot, dot))


def test_files_of_one_groom_concatenate() -> None:
    both = concatenate_strands([ragged(CORNER), ragged(STRAIGHT)])
    assert both.counts.tolist() == [3, 4]
    assert np.array_equal(both.roots, np.float32([[0, 0, 0], [1, 2, 3]]))
    with pytest.raises(InputError):
        concatenate_strands([])
