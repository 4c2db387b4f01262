from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from quaffure import InputError
from quaffure.apps.render import Camera, StrandRenderer, encode_video, scene
from quaffure.apps.render.framing import facing_deg, frame_hair
from quaffure.apps.render.pictures import write_picture
from quaffure.apps.render.scene import hair_cover, samples_of, width_of
from quaffure.apps.render.video import write_video
from tests.synthetic_drape import HEAD_CENTRE, ball, drape, patch_of_strands

SIZE = 96
GREEN = (0.0, 0.5, 0.0)


@pytest.fixture(scope="module")
def renderer() -> Iterator[StrandRenderer]:
    try:
        made = StrandRenderer(SIZE, SIZE, supersampling=2)
    except InputError as error:
        pytest.skip(f"no OpenGL here: {error}")
    yield made
    made.release()


def green_pixels(renderer: StrandRenderer, strands: np.ndarray, camera: Camera) -> np.ndarray:
    """Rows and columns of pixels [p, 2] where green hair is seen."""
    picture = renderer.render(strands, *ball(), camera, GREEN).astype(int)
    return np.argwhere(picture[..., 1] > picture[..., [0, 2]].max(axis=-1) + 15)


def test_hair_behind_the_head_is_hidden_from_the_front(renderer: StrandRenderer) -> None:
    strands = patch_of_strands((0.0, 1.0, 0.0))
    assert len(green_pixels(renderer, strands, Camera.view("back", HEAD_CENTRE, 0.4))) > 100
    assert len(green_pixels(renderer, strands, Camera.view("front", HEAD_CENTRE, 0.4))) == 0


@pytest.mark.parametrize(
    ("view", "towards", "side"),
    [
        # The body faces -y: its left hand, +x, is on the right of a picture of its face.
        ("front", (1.0, 0.0, 0.0), 1),
        ("front", (-1.0, 0.0, 0.0), -1),
        ("back", (1.0, 0.0, 0.0), -1),
        ("side", (0.0, 1.0, 0.0), 1),
        ("side", (0.0, -1.0, 0.0), -1),
    ],
)
def test_left_and_right(renderer: StrandRenderer, view: str, towards: tuple[float, float, float], side: int) -> None:
    columns = green_pixels(renderer, patch_of_strands(towards), Camera.view(view, HEAD_CENTRE, 0.4))[:, 1]
    assert len(columns) > 50
    assert ((columns - SIZE / 2) * side > 0.1 * SIZE).mean() > 0.95


def test_up_is_up(renderer: StrandRenderer) -> None:
    rows = green_pixels(renderer, patch_of_strands((0.0, 0.0, 1.0)), Camera.view("front", HEAD_CENTRE, 0.4))[:, 0]
    assert len(rows) > 50
    assert (rows < 0.4 * SIZE).all()


def test_extent_fills_the_picture(renderer: StrandRenderer) -> None:
    """A ball of 0.2 m in a frame of 0.2 m touches the borders, less the perspective's reserve."""
    picture = renderer.render(
        patch_of_strands((0.0, 1.0, 0.0)), *ball(), Camera.view("front", HEAD_CENTRE, 0.2)
    ).astype(int)
    columns = np.flatnonzero((picture[..., 0] > picture[..., 2] + 8).any(axis=0))
    assert 0.75 * SIZE < np.ptp(columns) <= SIZE


def test_colour_responds(renderer: StrandRenderer) -> None:
    strands, camera = patch_of_strands((0.0, -1.0, 0.3)), Camera.view("front", HEAD_CENTRE, 0.3)
    green, red = (renderer.render(strands, *ball(), camera, c).astype(int) for c in ((0.0, 0.4, 0.0), (0.4, 0.0, 0.0)))
    changed = np.abs(green - red).sum(axis=-1) > 30
    assert changed.sum() > 100
    assert (green[changed, 1] > red[changed, 1]).all()
    assert (green[changed, 0] < red[changed, 0]).all()
    assert green.std() > 10


def test_hair_casts_shadow(renderer: StrandRenderer) -> None:
    """Hair between the key light (the viewer's upper left) and the head darkens skin that it does not cover."""
    camera = Camera.view("front", HEAD_CENTRE, 0.3)
    lit = renderer.render(patch_of_strands((0.0, 1.0, 0.0)), *ball(), camera).astype(int)
    shadowed = renderer.render(
        patch_of_strands((-0.55, -0.6, 0.55)) + np.array([0, -0.06, 0], np.float32), *ball(), camera
    )
    below_right = slice(SIZE // 2, 3 * SIZE // 4), slice(SIZE // 4, SIZE // 2)
    assert (lit - shadowed)[below_right].max() > 12


def test_thin_hair_casts_no_streaks(renderer: StrandRenderer) -> None:
    """A curtain of single strands, out of sight, dims the skin evenly: no strand shows as a dark line."""
    curtain = np.zeros((21, 8, 3), np.float32)
    curtain[..., 0] = np.linspace(-0.205, -0.045, 21)[:, None]
    curtain[..., 1], curtain[..., 2] = -0.25, np.linspace(1.84, 1.76, 8)
    camera, rest = Camera.view("front", HEAD_CENTRE, 0.3), patch_of_strands((0.0, 1.0, 0.0))
    scenes = rest, np.concatenate([rest, curtain])
    lit, dimmed = (renderer.render(hair, *ball(), camera).astype(float).mean(axis=-1) for hair in scenes)
    shadow = (lit - dimmed)[40:50, 30:54].mean(axis=0)
    assert shadow.mean() > 2
    smooth = np.polyval(np.polyfit(np.arange(24), shadow, 3), np.arange(24))
    assert np.abs(shadow - smooth).max() < 0.4 * shadow.mean()


def test_hair_behind_the_head_leaves_the_face_lit(renderer: StrandRenderer) -> None:
    """The light's maps add up hair along a ray; what lies behind the body on it must not count."""
    camera = Camera.view("front", HEAD_CENTRE, 0.3)
    towards_light = np.array([-0.5, -0.6, 0.75]) / np.linalg.norm([-0.5, -0.6, 0.75])
    tuft = patch_of_strands((0.0, 1.0, 0.0))
    across = np.linspace(-0.05, 0.05, 8)[:, None] * np.cross(towards_light, [1.0, 0.0, 0.0])
    lying = (tuft[:, :1] - tuft[:, :1].mean(axis=0) + across).astype(np.float32)
    scenes = [
        np.concatenate([tuft, lying + (HEAD_CENTRE + reach * towards_light).astype(np.float32)])
        for reach in (-0.13, -5.0, 0.13)
    ]
    behind, away, before = (renderer.render(hair, *ball(), camera).astype(int) for hair in scenes)
    face = slice(28, 40), slice(30, 42)
    np.testing.assert_allclose(behind[face], away[face], atol=6)
    assert (away - before)[face].mean() > 5


def test_few_strands_stand_for_many() -> None:
    widths = [width_of(count) for count in (100, 2400, 20_000, 100_000, 10_000_000)]
    assert widths[0] == widths[1] == pytest.approx(0.8e-3)
    assert widths == sorted(widths, reverse=True)
    assert widths[-1] == pytest.approx(0.07e-3)


def test_curls_are_drawn_rounder_than_straight_hair() -> None:
    turn = np.linspace(0, 6 * np.pi, 24)
    helix = np.stack([0.01 * np.cos(turn), 0.01 * np.sin(turn), -0.004 * turn], axis=-1)
    assert samples_of(np.repeat(helix[None], 20, axis=0)) == 3
    assert samples_of(patch_of_strands((0.0, 0.0, 1.0))) == 1
    assert samples_of(np.zeros((5, 2, 3))) == 1


def test_buffers_follow_the_scene(renderer: StrandRenderer) -> None:
    """A picture does not depend on what was drawn before it, of another size or the same."""
    strands, camera = patch_of_strands((0.0, 0.0, 1.0)), Camera.view("front", HEAD_CENTRE, 0.4)
    first = renderer.render(strands, *ball(), camera)
    renderer.render(patch_of_strands((1.0, 0.0, 0.0), vertices=5), *ball(12), Camera.view("side", HEAD_CENTRE, 0.6))
    renderer.render(strands + np.float32(0.01), *ball(), camera)
    np.testing.assert_array_equal(renderer.render(strands, *ball(), camera), first)


def test_contact_sheet_has_four_rows_and_columns(renderer: StrandRenderer, tmp_path: Path) -> None:
    from PIL import Image

    write_picture(tmp_path / "sheet.png", drape(patch_of_strands((0.0, 0.0, 1.0)), frames=9), tile=32)
    with Image.open(tmp_path / "sheet.png") as sheet:
        assert sheet.size == (128, 128)
    write_picture(tmp_path / "sheet.png", drape(patch_of_strands((0.0, 0.0, 1.0)), frames=1), tile=32)
    with Image.open(tmp_path / "sheet.png") as sheet:
        assert sheet.size == (128, 32)


@pytest.mark.parametrize("frames", [1, 5])
def test_video_plays(renderer: StrandRenderer, tmp_path: Path, frames: int) -> None:
    import av

    seq = drape(patch_of_strands((0.0, 0.0, 1.0)), frames=frames)
    write_video(tmp_path / "drape.mp4", seq, tile=64)
    with av.open(str(tmp_path / "drape.mp4")) as container:
        stream = container.streams.video[0]
        decoded = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
        assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")
        assert stream.average_rate == 30
    assert [frame.shape for frame in decoded] == [(64, 128, 3)] * frames
    assert decoded[0].std() > 10


def test_pictures_that_make_no_video_are_refused(tmp_path: Path) -> None:
    for pictures, found in ([], "none"), ([np.zeros((4, 5, 3), np.uint8)], "5 x 4"):
        with pytest.raises(InputError, match=found):
            encode_video(tmp_path / "a.mp4", pictures, 30.0)
    assert list(tmp_path.iterdir()) == []


def test_wrong_suffix_or_folder_is_named(renderer: StrandRenderer, tmp_path: Path) -> None:
    seq = drape(patch_of_strands((0.0, 0.0, 1.0)))
    for write, name in ((write_picture, "a.jpg"), (write_video, "a.avi")):
        with pytest.raises(InputError, match=name):
            write(tmp_path / name, seq)
    for write, name in ((write_picture, "a.png"), (write_video, "a.mp4")):
        with pytest.raises(InputError, match="folder"):
            write(tmp_path / "none" / name, seq)
    assert list(tmp_path.iterdir()) == []


def test_frame_holds_hair_and_head() -> None:
    seq = drape(patch_of_strands((0.0, 1.0, 0.0)))
    centre, extent = frame_hair(seq)
    for part in (seq.strands, seq.body_vertices):
        assert (np.abs(part - centre.astype(np.float32)) <= 0.5 * extent).all()
    assert extent < 0.3


def test_machine_without_opengl_names_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    def no_library(**options: object) -> None:
        raise Exception("libEGL.so.1 not loaded\ndetails")

    monkeypatch.setattr(scene.moderngl, "create_context", no_library)
    with pytest.raises(InputError, match=r"apt install libegl1.*libEGL\.so\.1 not loaded") as caught:
        StrandRenderer(8, 8)
    assert "\n" not in str(caught.value)


def test_cameras_turn_with_the_body() -> None:
    seq = drape(patch_of_strands((0.0, 1.0, 0.0)))
    turned = replace(seq, body_pose=seq.body_pose.copy())
    turned.body_pose[:, :3] = [0.0, 0.0, np.pi / 2]  # faces +x
    assert facing_deg(seq, 0) == pytest.approx(0)
    assert facing_deg(turned, 0) == pytest.approx(90)
    assert Camera.view("front", (0, 0, 0), 1, 90).eye[0] > 1


def test_scalp_between_sparse_roots_has_no_bare_spots() -> None:
    """Dark spots round the roots of a hundred strands would look like a skin disease; a hairline stays sharp."""
    for spacing, beyond in ((0.02, 0.045), (0.004, 0.013)):
        grid = spacing * np.arange(8)
        roots = np.stack([*np.meshgrid(grid, grid), np.zeros((8, 8))], axis=-1).reshape(-1, 3)
        between = roots.reshape(8, 8, 3)[:-1, :-1].reshape(-1, 3) + 0.5 * spacing * np.array([1, 1, 0])
        assert hair_cover(between, roots).min() > 0.7
        off = roots[:8] - np.array([0, beyond, 0])
        assert not hair_cover(off, roots).any()
    assert hair_cover(np.zeros((1, 3)), np.zeros((1, 3))).tolist() == [1.0]
