"""Numbers and texture coordinates that exporters share, where some come from the strands' source."""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from quaffure.apps.cli.main import main
from quaffure.body import BodyModel
from quaffure.hair import ExportClip, GuideInterpolation, StrandAttributes
from quaffure.hair.strand_attributes import LARGEST_ID
from quaffure.io.read_strands import read_strands
from tests.export_clips import export_clip
from tests.training_runs import tiny_groom

STRANDS = 300
UNREALS_EXACT_INTEGERS = 2**24


@pytest.fixture(scope="module")
def clip(body: BodyModel) -> ExportClip:
    return export_clip(tiny_groom(body), body, STRANDS)


def with_attributes(clip: ExportClip, attributes: StrandAttributes) -> ExportClip:
    """The clip with strands whose source says this of them."""

    class Described(GuideInterpolation):
        @property
        def attributes(self) -> StrandAttributes:
            return attributes

    values = {each.name: getattr(clip.interpolation, each.name) for each in fields(GuideInterpolation)}
    return replace(clip, interpolation=Described(**values))


def test_guides_are_on_the_texture_of_the_strands(clip: ExportClip) -> None:
    uv = np.random.default_rng(0).uniform(2, 3, (STRANDS, 2)).astype(np.float32)
    found = with_attributes(clip, StrandAttributes(root_uv=uv))
    roots = clip.rest_points.reshape(STRANDS, -1, 3)[:, 0]
    distances = np.linalg.norm(roots[None] - clip.rest_guides[:, None, 0], axis=2)
    np.testing.assert_array_equal(found.guide_root_uv, uv[distances.argmin(axis=1)])
    np.testing.assert_array_equal(found.root_uv, uv)


def test_guides_have_small_numbers_of_their_own(clip: ExportClip) -> None:
    """Unreal reads the numbers of closest guides into float32."""
    own = np.arange(STRANDS)
    assert with_attributes(clip, StrandAttributes(identifier=own)).guide_identifiers.tolist() == [*range(300, 340)]
    own[:2] = LARGEST_ID, 301
    found = with_attributes(clip, StrandAttributes(identifier=own))
    assert found.guide_identifiers.tolist() == [0, 1, 300, *range(302, 339)]
    assert found.guide_identifiers.max() < UNREALS_EXACT_INTEGERS


def test_guides_are_in_the_group_of_the_strands_around_them(clip: ExportClip) -> None:
    """Unreal finds the closest guides of a strand within its group alone."""
    roots = clip.rest_points.reshape(STRANDS, -1, 3)[:, 0]
    attributes = StrandAttributes(group=(roots[:, 0] > 0).astype(np.int64), group_names=("right", "left"))
    found = with_attributes(clip, attributes)
    x = clip.rest_guides[:, 0, 0]
    far = np.abs(x) > 0.02  # m
    assert far.sum() > 20
    np.testing.assert_array_equal(found.guide_groups[far], (x > 0)[far])
    assert clip.guide_groups.tolist() == [0] * len(x)


def test_a_ply_has_root_coordinates_of_the_body(tmp_path: Path, tiny_groom_file: Path) -> None:
    options = ["--draper", "posed", "--motion", "nod", "--frames", "0:1"]
    main(["drape", str(tiny_groom_file), *options, "--out", str(tmp_path / "hair.ply")])
    found, expected = read_strands(tmp_path / "hair.ply").attributes.root_uv, np.load(tiny_groom_file)["root_uv"]
    np.testing.assert_array_equal(found, expected)


def test_tapers_are_the_same_on_guides_and_strands(clip: ExportClip) -> None:
    np.testing.assert_array_equal(clip.widths.reshape(STRANDS, -1), np.tile(clip.strand_width, (STRANDS, 1)))
    assert clip.strand_width[-1] == pytest.approx(0.35 * clip.strand_width[0])
