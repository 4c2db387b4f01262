"""The scalp of a character: what a hair mesh covers, what a user names, and what is no scalp."""

import numpy as np
import pytest
from numpy.typing import NDArray

from quaffure import InputError
from quaffure.body import BodyModel
from quaffure.character import Triangles
from quaffure.character.head_fit import HeadFit
from quaffure.character.parts import Part
from quaffure.character.scalp import Scalp, scalp_of_transferred, transferred_scalp
from quaffure.character.scalp_chart import check_disc
from quaffure.character.scalp_check import face_areas
from quaffure.character.scalp_source import HeadSurface, ScalpWish, scalp_of

igl = pytest.importorskip("igl")
HAIR = ScalpWish(hair_mesh="Wig")


@pytest.fixture(scope="module")
def head(body: BodyModel) -> HeadSurface:
    """The shipped body's own surface, on which its scalp is transferred to where it is."""
    surface = Triangles(body.rest_vertices.double().numpy(), body.faces.numpy())
    ears = body.ear_vertices.numpy()
    fit = HeadFit(np.ones(3), 0.0, np.zeros(3), np.zeros(3))
    return HeadSurface(surface, surface, ears, transferred_scalp(body, surface, ears, fit))


@pytest.fixture(scope="module")
def shipped(head: HeadSurface) -> Scalp:
    return scalp_of_transferred(head.transferred, head.at_rest, head.ears, "")


def part(name: str, vertices: NDArray[np.float64], faces: NDArray[np.int64], **attributes: NDArray[np.float64]) -> Part:
    return Part(name, "", vertices, faces, np.zeros((len(vertices), 27)), attributes)


def wig(head: HeadSurface, faces: NDArray[np.int64], size: float, name: str = "Wig") -> Part:
    """Faces of a surface, scaled about the middle of the head."""
    used, flat = np.unique(head.at_rest.faces[faces], return_inverse=True)
    middle = head.transferred.mesh.vertices.mean(0)
    return part(name, middle + size * (head.at_rest.vertices[used] - middle), flat.reshape(-1, 3))


def middles(head: HeadSurface, faces: NDArray[np.int64]) -> NDArray[np.float64]:
    return head.at_rest.vertices[head.at_rest.faces[faces]].mean(1)


@pytest.mark.parametrize("size", [1.1, 1.5])
def test_hair_that_stands_off_the_head_covers_it(head: HeadSurface, shipped: Scalp, size: float) -> None:
    """Up to 6 cm above the skin; the chart is the shipped body's, so that grooms sit as they do there."""
    hair = wig(head, shipped.faces, size)
    scalp, note = scalp_of(head, [hair], HAIR, "")
    assert len(np.intersect1d(scalp.faces, shipped.faces)) > 0.95 * len(shipped.faces)
    assert note.startswith("scalp: what Wig covers")
    shared = np.intersect1d(scalp.faces, shipped.faces, return_indices=True)
    apart = np.linalg.norm(scalp.uv[shared[1]] - shipped.uv[shared[2]], axis=-1)
    assert np.quantile(apart, 0.9) < 0.02


def test_chart_of_a_part_of_the_scalp_is_that_part_of_the_chart(head: HeadSurface, shipped: Scalp) -> None:
    half = shipped.faces[middles(head, shipped.faces)[:, 0] > -0.02]
    scalp, _ = scalp_of(head, [wig(head, half, 1.02)], HAIR, "")
    shared = np.intersect1d(scalp.faces, shipped.faces, return_indices=True)
    assert 0.9 * len(half) < len(shared[0]) < 1.15 * len(half)
    apart = np.linalg.norm(scalp.uv[shared[1]] - shipped.uv[shared[2]], axis=-1)
    assert np.median(apart) < 0.01
    assert np.quantile(apart, 0.9) < 0.04  # a triangle of a centimetre beside the scalp is under the hair, too


def test_hair_by_its_name_shows_the_scalp(head: HeadSurface, shipped: Scalp) -> None:
    """Where it covers one; brows and a ponytail do not."""
    lower = shipped.faces[middles(head, shipped.faces)[:, 1] < 0.02]
    wide = np.flatnonzero(head.transferred.distance(middles(head, np.arange(len(head.at_rest.faces)))) < 0.015)
    scalp, note = scalp_of(head, [wig(head, wide, 1.01, "Hair_Cap")], ScalpWish(), "")
    assert note.startswith("scalp: what Hair_Cap covers, found by name")
    assert len(scalp.faces) > 1.05 * len(shipped.faces)
    few = wig(head, lower[: len(lower) // 4], 1.01, "Hair_Tail")
    scalp, note = scalp_of(head, [few], ScalpWish(), "")
    np.testing.assert_array_equal(scalp.faces, shipped.faces)
    assert "Hair_Tail covers" in note


def skin(head: HeadSurface, scalp: NDArray[np.bool_]) -> list[Part]:
    """The surface as two parts, of which one is called a scalp."""
    surface = head.at_rest
    return [
        part("Scalp", surface.vertices, surface.faces[scalp]),
        part("Skin", surface.vertices, surface.faces[~scalp]),
    ]


def test_what_is_no_scalp_is_refused(head: HeadSurface, shipped: Scalp) -> None:
    """A hole at the crown, two halves, and a whole skin; each was repaired or cut without a word."""
    faces, at = np.arange(len(head.at_rest.faces)), middles(head, np.arange(len(head.at_rest.faces)))
    scalp, wish = np.isin(faces, shipped.faces), ScalpWish(name="scalp")
    crown = at[scalp][at[scalp][:, 2].argmax()]
    pierced = scalp & (np.linalg.norm(at - crown, axis=1) > 0.05)
    with pytest.raises(InputError, match=r"--scalp scalp: expected a closed scalp.*found an open scalp with a hole of"):
        scalp_of(head, skin(head, pierced), wish, "")
    with pytest.raises(InputError, match=r"expected a scalp in one piece, found 2 pieces of \d+, \d+ cm\^2"):
        scalp_of(head, skin(head, scalp & (abs(at[:, 0]) > 0.015)), wish, "")
    everything = part("Scalp", head.at_rest.vertices, head.at_rest.faces)
    with pytest.raises(InputError, match=r"expected a scalp within 5 cm .*found \d+ cm\^2 .*face, neck or shoulders"):
        scalp_of(head, [everything], wish, "")


def test_small_repairs_are_said(head: HeadSurface, shipped: Scalp) -> None:
    faces, at = np.arange(len(head.at_rest.faces)), middles(head, np.arange(len(head.at_rest.faces)))
    scalp = np.isin(faces, shipped.faces)
    crown = at[scalp][at[scalp][:, 2].argmax()]
    pierced = scalp & (np.linalg.norm(at - crown, axis=1) > 0.014)
    assert 0 < (scalp & ~pierced).sum() < 9
    chosen, note = scalp_of(head, skin(head, pierced), ScalpWish(name="scalp"), "")
    assert "1 small holes filled" in note
    areas = face_areas(head.at_rest)
    assert float(areas[chosen.faces].sum()) == pytest.approx(float(areas[scalp].sum()), rel=0.02)
    eared = scalp | np.isin(head.at_rest.faces, head.ears).any(1)
    assert "ears left out" in scalp_of(head, skin(head, eared), ScalpWish(name="scalp"), "")[1]


def test_what_is_no_disc_is_refused(body: BodyModel) -> None:
    faces = body.faces[body.scalp.faces].numpy()
    check_disc(faces, "")
    inner = np.flatnonzero(~np.isin(faces, igl.boundary_loop(faces)).any(1))[0]
    two, pierced = np.concatenate([faces, faces.max() + 1 + faces]), np.delete(faces, inner, 0)
    for patch, found in ((faces[:9], "at least 40 triangles"), (two, "one disc"), (pierced, "Euler characteristic 0")):
        with pytest.raises(InputError, match=rf"scalp: expected a scalp .*{found}"):
            check_disc(patch, "scalp")
