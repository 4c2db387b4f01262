"""Files of an imported body's hair, in the scene of its character: read back, they line up with the character."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from quaffure import InputError
from quaffure.apps.cli.inputs import character_space_of
from quaffure.apps.cli.main import main
from quaffure.apps.cli.outputs import asset_path, write_output
from quaffure.body import BodyModel, Character, frame_times, poses_at
from quaffure.body.own_motion import own_motion
from quaffure.extras import is_installed
from quaffure.hair import AnimatedSkin, CharacterSpace, ExportClip, ExportSettings
from quaffure.hair.character_space import skin_of
from quaffure.hair.placed_clip import PlacedClip, placed_clip
from quaffure.io import character_scene, read_drape, write_drape
from quaffure.io.read_character import read_character
from quaffure.io.read_strands import read_strands
from tests.characters import character
from tests.synthetic_drape import drape, patch_of_strands
from tests.test_own_motion import FPS, binding_of, drape_of, moving, own_body, scalp_vertices

FRAME = 4


@pytest.fixture(scope="module")
def written(body: BodyModel) -> tuple[PlacedClip, Character, np.ndarray]:
    """A clip, its character, and the vertices of the character that hair grows on."""
    rest = character(body)
    own, moved = own_body(rest, body), moving(rest)
    chosen = scalp_vertices(own)[::90]
    motion = own_motion(moved, moved.animations[0], own, FPS)
    skin = AnimatedSkin(moved, moved.animations[0], moved.meshes[0], frame_times(moved.animations[0], FPS, 100))
    clip = ExportClip(drape_of(own, motion, chosen), binding=binding_of(own, chosen))
    assert own.origin is not None
    return placed_clip(clip, CharacterSpace(own.origin, motion.start, skin)), moved, chosen


def roots_in_file(moved: Character, chosen: np.ndarray, frame: int) -> np.ndarray:
    (poses,) = poses_at(moved, moved.animations[0], frame_times(moved.animations[0], FPS, 100)[frame : frame + 1])
    return moved.meshes[0].posed(poses.world[0])[chosen]


def test_usd_has_the_axes_and_the_frames_of_the_file(
    written: tuple[PlacedClip, Character, np.ndarray], tmp_path: Path
) -> None:
    pxr = pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom

    assert pxr
    clip, moved, chosen = written
    write_output(tmp_path / "hair.usd", clip)
    stage = Usd.Stage.Open(str(tmp_path / "hair.usd"))
    assert UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.y
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode(), stage.GetTimeCodesPerSecond()) == (15, 23, FPS)
    points = np.array(UsdGeom.BasisCurves.Get(stage, "/Drape/Hair/Strands").GetPointsAttr().Get(15 + FRAME))
    expected = roots_in_file(moved, chosen, FRAME)
    np.testing.assert_allclose(points.reshape(-1, 3, 3)[:, 0], expected, atol=0.01)  # centimetres
    skin = np.array(UsdGeom.Mesh.Get(stage, "/Drape/Body").GetPointsAttr().Get(15 + FRAME))
    np.testing.assert_allclose(skin[chosen], expected, atol=0.01)


def test_roots_are_on_the_texture_of_the_skin(written: tuple[PlacedClip, Character, np.ndarray]) -> None:
    """Roots are at vertices of the skin, whose texture coordinates the file's body has."""
    clip, moved, chosen = written
    mesh = moved.meshes[0]
    uv = np.random.default_rng(0).uniform(size=(len(mesh.vertices), 2))
    skin = AnimatedSkin(moved, moved.animations[0], replace(mesh, uv=uv), np.zeros(1))
    found = placed_clip(clip.inner, replace(clip.space, skin=skin))
    expected = np.stack([uv[chosen, 0], 1 - uv[chosen, 1]], axis=1)
    np.testing.assert_allclose(found.root_uv, expected, atol=1e-3)
    np.testing.assert_allclose(found.guide_root_uv, expected[found.guide_index], atol=1e-3)


def test_glb_has_the_place_and_the_times_of_the_file(
    written: tuple[PlacedClip, Character, np.ndarray], tmp_path: Path
) -> None:
    clip, moved, chosen = written
    write_output(tmp_path / "hair.glb", clip)
    found = read_character(tmp_path / "hair.glb")
    (animation,) = found.animations
    assert animation.span == pytest.approx((0.5, 0.5 + 8 / FPS))
    (poses,) = poses_at(found, animation, np.array([0.5 + FRAME / FPS]))
    hair, skin = found.mesh("Hair"), found.mesh("Body")
    ribbons = hair.posed(poses.world[0], poses.morph_weights[hair.node][0]).reshape(len(chosen), 3, 2, 3)
    expected = roots_in_file(moved, chosen, FRAME)
    np.testing.assert_allclose(ribbons.mean(2)[:, 0], expected, atol=0.01)
    vertices = skin.posed(poses.world[0], poses.morph_weights[skin.node][0])
    np.testing.assert_allclose(vertices[chosen], expected, atol=0.01)


@pytest.mark.skipif(not is_installed("alembic3d"), reason="no Alembic")
def test_alembic_lines_up_in_unreal(written: tuple[PlacedClip, Character, np.ndarray], tmp_path: Path) -> None:
    """Its importers turn y up to z up and mirror; one unit of glTF is a hundred of theirs."""
    from alembic3d import Abc, AbcGeom

    clip, moved, chosen = written
    path = tmp_path / "hair.abc"
    write_output(path, clip)
    assert asset_path(path).exists()
    top = Abc.IArchive(str(path)).getTop().getChild("groom").getChild("strands")
    schema = AbcGeom.ICurves(top, "curves").getSchema()
    assert schema.getTimeSampling().getSampleTime(0) == pytest.approx(0.5)
    time = schema.getTimeSampling().getSampleTime(FRAME)
    points = np.array(schema.getValue(Abc.ISampleSelector(time)).getPositions(), np.float32).reshape(-1, 3, 3)
    x, y, z = roots_in_file(moved, chosen, FRAME).T
    np.testing.assert_allclose(points[:, 0], 100 * np.stack([x, z, y], axis=1), atol=1.0)


def test_files_of_one_frame_line_up(written: tuple[PlacedClip, Character, np.ndarray], tmp_path: Path) -> None:
    """Z up as programs turn glTF, or y up as their formats ask."""
    clip, moved, chosen = written
    one = drape_frame(clip, FRAME)
    roots = roots_in_file(moved, chosen, FRAME)
    for suffix, factor, y_up in ((".ply", 1, False), (".hair", 1, False), (".data", 1, True), (".bin", 1000, True)):
        write_output(tmp_path / f"hair{suffix}", one)
        points = read_strands(tmp_path / f"hair{suffix}").points.reshape(-1, 3, 3)[:, 0] / factor
        expected = roots if y_up else roots[:, [0, 2, 1]] * np.array([1, -1, 1])
        np.testing.assert_allclose(points, expected, atol=0.01, err_msg=suffix)


def drape_frame(clip: PlacedClip, frame: int) -> PlacedClip:
    """One frame of a clip."""
    own, skin = clip.sequence, clip.space.skin
    assert skin is not None
    assert own.body_translation is not None
    sequence = replace(
        own, strands=own.strands[frame : frame + 1], posed=own.posed[frame : frame + 1],
        body_vertices=own.body_vertices[frame : frame + 1], body_pose=own.body_pose[frame : frame + 1],
        body_translation=own.body_translation[frame : frame + 1],
    )  # fmt: skip
    space = replace(clip.space, skin=replace(skin, times=skin.times[frame : frame + 1], _last={}))
    return placed_clip(ExportClip(sequence, binding=clip.binding), space)


def test_drape_files_hold_the_way_to_the_file(
    written: tuple[PlacedClip, Character, np.ndarray], tmp_path: Path
) -> None:
    clip, moved, chosen = written
    write_output(tmp_path / "hair.npz", clip)
    np.testing.assert_array_equal(read_drape(tmp_path / "hair.npz").strands, clip.sequence.strands)
    with np.load(tmp_path / "hair.npz") as arrays:
        strands = arrays["file_scale"] * arrays["strands"][FRAME] @ arrays["file_rotation"].T
        roots = strands[:, 0] + arrays["file_translation"] + arrays["root_offset"][FRAME]
        assert float(arrays["file_start"]) == 0.5
    np.testing.assert_allclose(roots, roots_in_file(moved, chosen, FRAME), atol=0.01)


def test_a_drape_file_keeps_when_its_motion_starts(
    written: tuple[PlacedClip, Character, np.ndarray], tmp_path: Path
) -> None:
    sequence = written[0].sequence
    assert sequence.times[0] == 0
    write_drape(tmp_path / "hair.npz", replace(sequence, meta={"start": 0.5}))
    found = read_drape(tmp_path / "hair.npz")
    np.testing.assert_allclose(found.times, 0.5 + np.arange(9) / FPS)
    for wrong in ("0.5", 1e300, None, True):
        assert replace(found, meta={"start": wrong}).times[0] == 0


def test_another_motion_is_placed_without_the_file(written: tuple[PlacedClip, Character, np.ndarray]) -> None:
    clip = written[0]
    other = replace(clip, space=replace(clip.space, skin=None))
    np.testing.assert_allclose(other.points(2), clip.points(2), atol=0.01)  # the body has every joint of this file
    np.testing.assert_array_equal(other.body_faces, clip.inner.body_faces)
    assert "root_offset" not in other.file_arrays()
    with pytest.raises(InputError, match="one of the body that was imported"):
        placed_clip(ExportClip(clip.sequence), clip.space)


def test_a_drape_in_place_stays_there_in_the_animation_of_the_file(
    written: tuple[PlacedClip, Character, np.ndarray],
) -> None:
    clip = written[0]
    path = clip.sequence.body_translation
    assert path is not None
    inner = replace(clip.inner, sequence=clip.sequence.in_place())
    still = placed_clip(inner, clip.space)
    for frame in (0, FRAME, 8):
        moved = clip.space.origin.scale * clip.space.origin.rotation @ path[frame].astype(float)
        np.testing.assert_allclose(still.points(frame), clip.points(frame) - moved, atol=0.01)
        np.testing.assert_allclose(still.strands(frame), clip.strands(frame) - moved, atol=0.01)
        np.testing.assert_allclose(still.body_vertices(frame), clip.body_vertices(frame) - moved, atol=0.01)
    assert np.linalg.norm(moved) > 20  # centimetres
    # Roots are where the drape has them, but for what the file's skin adds, which is nothing here.
    assert np.abs(still.file_arrays()["root_offset"]).max() < 0.01
    assert replace(clip.space, skin=None).in_place().skin is None


def test_the_skin_is_found_by_place_and_hair_is_left_out(body: BodyModel) -> None:
    rest = character(body)
    own = own_body(rest, body)
    (skin,) = rest.meshes
    cap = replace(skin, name="Hair_cap")
    fair = replace(skin, name="Hairless_Body")
    far = replace(skin, name="Shirt", vertices=skin.vertices * 1.2)
    many = replace(rest, meshes=(far, cap, skin))
    scalp = own.rest_vertices[scalp_vertices(own)].double().numpy()
    assert own.origin is not None
    assert skin_of(many, own.origin, scalp) is skin
    assert skin_of(replace(rest, meshes=(far, cap, fair)), own.origin, scalp) is fair
    lashes = replace(skin, name="Part", materials=("Eyelashes",))
    assert skin_of(replace(rest, meshes=(lashes, skin)), own.origin, scalp) is skin
    assert skin_of(replace(rest, meshes=(cap,)), own.origin, scalp) is cap
    with pytest.raises(InputError, match="a mesh within 5 mm of the scalp of its body, found Shirt"):
        skin_of(replace(rest, meshes=(far,)), own.origin, scalp)


def test_a_skeleton_of_the_body_is_refused(written: tuple[PlacedClip, Character, np.ndarray], body: BodyModel) -> None:
    own = own_body(character(body), body)
    motion = own_motion(written[1], written[1].animations[0], own, FPS)
    with pytest.raises(InputError, match="--skinned"):
        character_space_of("walk", own, motion.times, ExportSettings(skinned=True))
    assert character_space_of("walk", body, motion.times, ExportSettings(skinned=True)) is None


def test_a_retargeted_motion_is_not_the_file_s_own(
    written: tuple[PlacedClip, Character, np.ndarray], body: BodyModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A joint map gives another motion than the skin of the file has."""
    own = own_body(character(body), body)
    monkeypatch.setattr(character_scene, "read_character", lambda path: written[1])
    times = frame_times(written[1].animations[0], FPS, 100)
    retargeted = character_space_of("character.glb", own, times, ExportSettings(), Path("map.toml"))
    animated = character_space_of("character.glb", own, times, ExportSettings())
    assert retargeted is not None
    assert animated is not None
    assert (retargeted.skin, retargeted.start) == (None, times[0])
    assert animated.skin is not None


def test_a_motion_that_is_not_read_is_refused(
    body: BodyModel, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    write_drape(tmp_path / "hair.npz", drape(patch_of_strands((0.0, 1.0, 0.0))))
    for motion in ("walk.glb", str(tmp_path / "missing.bvh")):
        with pytest.raises(SystemExit) as stop:
            main(["render", str(tmp_path / "hair.npz"), "--motion", motion, "--out", str(tmp_path / "hair.glb")])
        assert stop.value.code == 2
        said = " ".join(capfd.readouterr().err.split())
        assert f"--motion: expected the body of the character whose file it is, by --body, found {motion} on" in said
    own, times = own_body(character(body), body), np.zeros(1)
    for missing in ("missing.bvh", "run"):
        with pytest.raises(InputError, match=f"{missing}: expected a motion file .* or a bundled motion"):
            character_scene.read_character_space(own, missing, times)
    for known in ("", "walk"):
        space = character_scene.read_character_space(own, known, times)
        assert space is not None
        assert space.skin is None


def test_a_file_of_animations_has_no_skin(
    written: tuple[PlacedClip, Character, np.ndarray], body: BodyModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = own_body(character(body), body)
    times = frame_times(written[1].animations[0], FPS, 100)
    without = replace(written[1], meshes=())
    monkeypatch.setattr(character_scene, "read_character", lambda path: without)
    space = character_scene.read_character_space(own, "animation.glb", times)
    assert space is not None
    assert (space.skin, space.start) == (None, times[0])
