"""Where a body goes in the world: from the file of its motion to the drape, its files and pictures."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from quaffure import InputError
from quaffure.apps.cli.main import main
from quaffure.apps.render.pictures import write_picture
from quaffure.apps.viewer.view_state import ViewState
from quaffure.baselines import PosedDraper
from quaffure.benchmark import measure
from quaffure.body import BodyModel, Motion, bundled_clip, resample, retarget_bvh
from quaffure.drape_motion import drape_motion
from quaffure.geometry import axis_angle_from_matrix, matrix_from_axis_angle
from quaffure.hair import DrapeSequence, Groom
from quaffure.io import read_amass, read_bvh, read_drape, write_drape, write_groom, write_usd
from quaffure.io.read_motion import read_motion
from quaffure.io.read_strands import read_strands
from quaffure.model import NeuralDraper, ProjectionConfig, load_model
from quaffure.procedural import make_groom
from tests.synthetic_drape import drape as synthetic_drape
from tests.synthetic_drape import patch_of_strands
from tests.test_retarget import CHANNELS, NAMES, daz_clip

MEAN_SHAPE = torch.zeros(10)
PATH = torch.tensor([[1.0, -2.0, 0.1], [1.1, -2.2, 0.05], [1.2, -2.4, 0.0]])
WALK = "motion/07_01.bvh"


@pytest.fixture(scope="module")
def groom(body: BodyModel) -> Groom:
    whole = make_groom("bob", body)
    return whole.select(torch.linspace(0, len(whole) - 1, 60).long())


@pytest.fixture(scope="module")
def walk(body: BodyModel) -> Motion:
    """Three frames of a bundled clip, along a path."""
    return replace(bundled_clip("walk", body).select(slice(10, 13)), translation=PATH)


@pytest.fixture(scope="module")
def moved(walk: Motion, groom: Groom, body: BodyModel) -> DrapeSequence:
    return drape_motion(PosedDraper(), groom, body, walk, MEAN_SHAPE)


def test_translations_follow_the_frames() -> None:
    path = torch.arange(12.0).reshape(4, 3)
    motion = Motion(torch.zeros(4, 81), 30.0, "walk", path)
    found = motion.frames("1:4:2").translation
    assert found is not None
    assert torch.equal(found, path[1::2])
    faster = resample(motion, 60.0).translation
    assert faster is not None
    assert torch.allclose(faster[1], 0.5 * (path[0] + path[1]))
    assert motion.in_place().translation is None
    with pytest.raises(InputError, match=r"translations \[4, 3\]"):
        Motion(torch.zeros(4, 81), 30.0, "walk", path[:3])
    with pytest.raises(InputError, match="within 1000 m"):
        Motion(torch.zeros(4, 81), 30.0, "walk", path * torch.nan)


@pytest.mark.parametrize(("unit", "offset"), [(1.0, 0.0), (0.01, 90.0), (0.0564, 0.0)])
def test_bvh_paths_are_in_metres(unit: float, offset: float, body: BodyModel) -> None:
    """The actor stands at its own height, takes a step of a metre to the front, and squats by 0.1 m."""
    clip = daz_clip(np.zeros((3, len(NAMES), 3)))
    ankle = body.rest_joints[body.joint_names.index("LeftFoot"), 2].item()
    standing = 80.0 + 100 * ankle  # cm; the hip is 80 above the ankle
    centimetres = np.array([[20.0, standing, 30.0], [20.0, standing, 130.0], [20.0, standing - 10, 130.0]])
    in_file = 0.01 / unit
    clip = replace(
        clip,
        offsets=in_file * clip.offsets + [[0.0, in_file * offset, 0.0]] * (np.arange(len(NAMES)) == 0)[:, None],
        channels=(("Xposition", "Yposition", "Zposition", *CHANNELS), *clip.channels[1:]),
        values=np.concatenate([in_file * centimetres, clip.values], axis=1),
    )
    found = retarget_bvh(clip, body).translation
    assert found is not None
    pelvis = found + body.rest_joints[0] * torch.tensor([1.0, 1.0, 0.0])
    # Where the skeleton is of no known unit, it is made as large as the body.
    tolerance = 0.01 if unit in (1.0, 0.01) else 0.15
    expected = torch.tensor([[0.2, -0.3, 0.0], [0.2, -1.3, 0.0], [0.2, -1.3, -0.1]])
    assert (pelvis - expected).abs().max() < tolerance
    assert retarget_bvh(daz_clip(np.zeros((3, len(NAMES), 3))), body).translation is None


@pytest.mark.parametrize("y_up", [False, True])
def test_amass_paths_are_the_pelvis(y_up: bool, tmp_path: Path, body: BodyModel) -> None:
    path = np.array([[1.0, -2.0, 0.9], [1.0, -2.0, 0.9], [1.2, -2.4, 0.95]])
    poses = np.zeros((3, 66))
    poses[:, 0] = 0.0 if y_up else np.pi / 2
    trans = path[:, [0, 2, 1]] * [1, 1, -1] if y_up else path
    np.savez(tmp_path / "walk.npz", poses=poses, trans=trans, mocap_framerate=30.0)
    found = read_amass(tmp_path / "walk.npz", body).translation
    assert found is not None
    np.testing.assert_allclose(found + body.rest_joints[0], path, atol=1e-6)
    np.savez(tmp_path / "bad.npz", poses=poses, trans=trans[:2], mocap_framerate=30.0)
    with pytest.raises(InputError, match=r"finite trans \[3, 3\]"):
        read_amass(tmp_path / "bad.npz", body)


def test_body_and_hair_travel_along_the_path(walk: Motion, moved: DrapeSequence, groom: Groom, body: BodyModel) -> None:
    still = drape_motion(PosedDraper(), groom, body, walk.in_place(), MEAN_SHAPE)
    assert still.body_translation is None
    for name in ("strands", "posed", "body_vertices"):
        difference = getattr(moved, name) - getattr(still, name)
        path = PATH.numpy().reshape(3, *[1] * (difference.ndim - 2), 3)
        np.testing.assert_allclose(difference, np.broadcast_to(path, difference.shape), atol=1e-6)
        np.testing.assert_allclose(getattr(moved.in_place(), name), getattr(still, name), atol=1e-6)
    assert still.in_place() is still


def test_metrics_do_not_depend_on_the_path(moved: DrapeSequence, groom: Groom, body: BodyModel) -> None:
    reference = moved.in_place()
    found, _ = measure(moved, groom, body, reference)
    expected, _ = measure(reference, groom, body, moved)
    for name, values in expected.items():
        assert torch.allclose(found[name], values, rtol=1e-3, atol=1e-3), name
    assert found["distance_mm"].max() < 1e-3


def test_files_keep_the_path(moved: DrapeSequence, tmp_path: Path, body: BodyModel) -> None:
    write_drape(tmp_path / "moved.npz", moved)
    again = read_drape(tmp_path / "moved.npz")
    assert again.body_translation is not None
    assert moved.body_translation is not None
    assert np.array_equal(again.body_translation, moved.body_translation)
    motion = read_motion(tmp_path / "moved.npz", body)
    assert motion.translation is not None
    assert torch.equal(motion.translation, PATH)
    write_drape(tmp_path / "still.npz", moved.in_place())
    with np.load(tmp_path / "still.npz") as file:
        assert "body_translation" not in file
    assert read_drape(tmp_path / "still.npz").body_translation is None
    write_usd(tmp_path / "moved.usdc", moved)
    assert (
        np.abs(read_strands(tmp_path / "moved.usdc").points.reshape(moved.strands.shape[1:]) - moved.strands[0]).max()
        == 0
    )


def test_cameras_travel_with_the_body(tmp_path: Path) -> None:
    seq = synthetic_drape(patch_of_strands((0.0, 0.0, 1.0)))
    write_picture(tmp_path / "still.png", seq, tile=64)
    write_picture(tmp_path / "moved.png", seq.moved(64 * PATH.numpy()), tile=64)
    from PIL import Image

    with Image.open(tmp_path / "still.png") as still, Image.open(tmp_path / "moved.png") as travelling:
        difference = np.abs(np.asarray(still).astype(int) - np.asarray(travelling).astype(int))
    assert difference.mean() < 1.0


def test_the_page_shows_the_path(walk: Motion, groom: Groom, body: BodyModel) -> None:
    shown = ViewState(body, groom, walk, PosedDraper(), frame=1).drape()
    np.testing.assert_allclose(shown.path, [1.1, -2.2, 0.0], atol=1e-6)
    still = ViewState(body, groom, walk.in_place(), PosedDraper(), frame=1).drape()
    assert np.array_equal(shown.inside(shown.strands), still.inside(still.strands))
    assert not still.path.any()


def test_the_network_drapes_a_turned_and_moved_body_alike(
    walk: Motion, groom: Groom, body: BodyModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    draper = load_model().draper
    # Where hair starts nearer, and is pushed once, less contact enlarges the roundings.
    near = replace(draper.network.config.initial_shape, bend_relaxation=0.0, margin_slope=0.6)
    once = ProjectionConfig(pushes=1, push_relaxation=0.0)
    monkeypatch.setattr(draper.network, "config", replace(draper.network.config, initial_shape=near, projection=once))
    draper = NeuralDraper(draper.network, draper.material)
    still = drape_motion(draper, groom, body, walk.in_place(), MEAN_SHAPE)
    turn = torch.from_numpy(Rotation.from_euler("z", 130, degrees=True).as_matrix())
    hips = axis_angle_from_matrix(turn @ matrix_from_axis_angle(walk.body_pose[:, :3].double())).float()
    turned = replace(walk, body_pose=torch.cat([hips, walk.body_pose[:, 3:]], dim=1))
    found = drape_motion(draper, groom, body, turned, MEAN_SHAPE)
    pelvis = body.rest_joints[0].numpy()
    expected = (still.strands - pelvis) @ turn.numpy().T + pelvis + PATH.numpy()[:, None, None]
    assert np.abs(found.strands - expected).max() < 1e-5


@pytest.mark.shared_data
def test_a_walk_travels_in_the_drape_as_in_its_file(shared_data: Path, groom: Groom, body: BodyModel) -> None:
    clip = read_bvh(shared_data / WALK)
    motion = retarget_bvh(clip, body)
    drape = drape_motion(PosedDraper(), groom, body, motion, MEAN_SHAPE)
    # Centimetres, y up, 120 fps; the first 15 frames lead in from the rest pose.
    file = 0.01 * clip.values[15::4, :3] @ np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    assert drape.body_translation is not None
    pelvis = drape.body_vertices[:, body.dense_skin_weights[:, 0].argmax()]
    steps, expected = pelvis[-1] - pelvis[0], file[len(pelvis) - 1] - file[0]
    assert np.linalg.norm(expected) > 2.0
    assert np.abs(steps - expected).max() < 0.03  # the hips turn about their centre
    np.testing.assert_allclose(drape.body_translation - drape.body_translation[0], file - file[0], atol=1e-3)
    # Feet neither hang in the air nor sink into the floor.
    assert abs(float(np.median(drape.body_vertices[..., 2].min(axis=1)))) < 0.08


@pytest.mark.shared_data
def test_in_place_is_the_drape_without_the_path(
    shared_data: Path, groom: Groom, tmp_path: Path, body: BodyModel
) -> None:
    write_groom(tmp_path / "few.npz", groom)
    command = ["drape", str(tmp_path / "few.npz"), "--motion", str(shared_data / WALK), "--frames", "20:24"]
    for name, options in (("moved", []), ("still", ["--in-place"])):
        main([*command, "--draper", "posed", *options, "--out", str(tmp_path / f"{name}.npz")])
    travelling, still = (read_drape(tmp_path / f"{name}.npz") for name in ("moved", "still"))
    assert still.body_translation is None
    motion = read_motion(shared_data / WALK, body).in_place().frames("20:24")
    assert np.array_equal(still.strands, drape_motion(PosedDraper(), groom, body, motion, MEAN_SHAPE).strands)
    np.testing.assert_allclose(travelling.in_place().strands, still.strands, atol=1e-6)
