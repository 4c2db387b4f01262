"""Roots of a groom on a character: its axes and unit, and what was made on another head."""

import numpy as np
import pytest

from quaffure import InputError
from quaffure.body import BodyModel
from quaffure.character import Triangles, fit_skeleton
from quaffure.character.groom_roots import roots_on
from quaffure.character.skeleton import FittedSkeleton
from tests.characters import character

pytest.importorskip("igl")


@pytest.fixture(scope="module")
def skeleton(body: BodyModel) -> FittedSkeleton:
    return fit_skeleton(character(body, centimetres=False), body)


@pytest.fixture(scope="module")
def surface(body: BodyModel, skeleton: FittedSkeleton) -> Triangles:
    (mesh,) = character(body, centimetres=False).meshes
    return Triangles(skeleton.in_body_space(mesh.vertices), mesh.faces)


def roots_of(body: BodyModel) -> np.ndarray:
    """On one side of the head, y up, in metres."""
    (mesh,) = character(body, centimetres=False).meshes
    on_scalp = mesh.vertices[np.unique(body.faces[body.scalp.faces].numpy())]
    return np.asarray(on_scalp[on_scalp[:, 0] > 0])


@pytest.mark.parametrize(
    ("columns", "signs", "unit", "how"),
    [
        ([0, 1, 2], [1, 1, 1], 1.0, ""),
        ([0, 2, 1], [1, -1, 1], 1.0, ", read with z up where the character has y up, a unit of it as 1"),  # our .hair
        ([0, 2, 1], [1, 1, 1], 100.0, ", read with y and z exchanged, as for Unreal, a unit of it as 0.01"),  # our .abc
        ([0, 1, 2], [1, 1, 1], 1000.0, ", read with the axes of the character, a unit of it as 0.001"),  # our .bin
    ],
)
def test_roots_in_the_axes_of_their_format(
    body: BodyModel,
    skeleton: FittedSkeleton,
    surface: Triangles,
    columns: list[int],
    signs: list[int],
    unit: float,
    how: str,
) -> None:
    roots = roots_of(body)
    found, words = roots_on(surface, unit * roots[:, columns] * signs, skeleton.in_body_space, "hair")
    np.testing.assert_allclose(found, skeleton.in_body_space(roots), atol=1e-9)
    assert words == how


def test_roots_of_another_head_are_refused(body: BodyModel, skeleton: FittedSkeleton, surface: Triangles) -> None:
    expected = (
        r"other.hair: expected roots on the head .*groom import --body fits it\), found \d.* m apart, .* in other"
    )
    with pytest.raises(InputError, match=expected):
        roots_on(surface, roots_of(body) + np.array([0.0, 0.5, 0.0]), skeleton.in_body_space, "other.hair")
    with pytest.raises(InputError, match="expected strands with roots, found none"):
        roots_on(surface, np.zeros((0, 3)), skeleton.in_body_space, "other.hair")
