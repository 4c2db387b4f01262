"""`quaffure inspect`, of a file of every kind."""

import json
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from quaffure import InputError
from quaffure.apps.cli.file_summary import summary_of
from quaffure.apps.cli.main import main
from quaffure.apps.cli.outputs import asset_path, write_output
from quaffure.body import BodyModel
from quaffure.hair import ExportClip, FileFrame
from quaffure.io import write_drape
from quaffure.model.quaffure_model import WEIGHTS
from tests.fuzzing.seeds import seeds
from tests.synthetic_drape import drape, patch_of_strands


@pytest.mark.shared_data
def test_strands(shared_data: Path, body: BodyModel) -> None:
    path = shared_data / "cases/one_point_strands.hair"
    found = summary_of(path, body)
    assert (found["kind"], found["strands"], found["bald_roots"], found["points_a_strand"]) == (
        "strands",
        360,
        40,
        [24, 24],
    )
    assert (found["unit"], found["up"], found["forward"], found["strands_on_the_scalp"]) == ("cm", "+y", "+z", 360)
    assert found["length_m"]["mean"] == pytest.approx(0.369, abs=1e-3)
    assert found["length_units"]["mean"] == pytest.approx(36.9, abs=0.1)
    assert (found["attributes"], found["groups"]) == (["width"], [])
    assert "refused" not in found
    known = summary_of(path, body, frame=FileFrame("y", "z", "mm"))
    assert "of the vertices inside the body" in known["refused"]
    assert known["strands"] == 360


def test_strands_that_are_no_hair_say_what_would_be_refused(tmp_path: Path, body: BodyModel) -> None:
    np.save(tmp_path / "line.npy", np.cumsum(np.ones((40, 5, 3)), axis=1))
    found = summary_of(tmp_path / "line.npy", body)
    assert (found["strands"], found["points"]) == (40, 200)
    assert found["refused"] == (
        "expected roots spread over a part of a head (of a groom in parts, name all files), found roots in one point"
    )


@pytest.mark.shared_data
def test_motion_and_its_joint_map(shared_data: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    rig, saved = str(shared_data / "rigs/chest_collar_elbow.bvh"), tmp_path / "map.toml"
    main(["inspect", rig, "--json", "--save-joints", str(saved)])
    found = json.loads(capfd.readouterr().out)
    assert (found["kind"], found["joints"], found["frames_of_the_file"], found["frames"]) == ("motion", 19, 455, 454)
    assert found["joint_map"]["LeftArm"] == ["LeftShoulder"]
    assert found["joint_map"]["LowerBack"] == ["Hips", "Chest"]
    assert 'LeftArm = "LeftShoulder"' in saved.read_text(encoding="utf-8")
    main(["inspect", rig, "--joints", str(saved)])
    said = capfd.readouterr().out
    assert "LeftForeArm: LeftElbow" in said
    assert "can be used as --motion of quaffure drape" in said
    saved.write_text('Hips = "Hips"\n', encoding="utf-8")
    main(["inspect", rig, "--joints", str(saved)])
    assert "refused: expected joints whose names are known" in capfd.readouterr().out


@pytest.mark.shared_data
def test_motion_of_smpl_says_which_axis_is_up(shared_data: Path, body: BodyModel) -> None:
    found = summary_of(shared_data / "cases/a_camera_ydown.npz", body)
    assert (found["kind"], found["frames"], found["fps"]) == ("motion", 120, 30.0)
    assert found["notes"] == ["+y is down, as in the frame of a camera"]
    assert found["head_above_hips_m"] == pytest.approx(0.68, abs=0.01)


def test_frames_of_a_motion_of_another_rate_are_those_that_are_draped(tmp_path: Path, body: BodyModel) -> None:
    np.savez(tmp_path / "poses.npz", body_pose=np.zeros((121, 81), np.float32), fps=60.0)
    found = summary_of(tmp_path / "poses.npz", body)
    assert (found["frames"], found["fps"], found["seconds"]) == (61, 30.0, 2.0)
    assert (found["frames_of_the_file"], found["fps_of_the_file"]) == (121, 60.0)


def test_every_other_kind(tmp_path: Path, body: BodyModel, tiny_groom_file: Path) -> None:
    groom = summary_of(tiny_groom_file, body)
    assert (groom["kind"], groom["points_a_strand"]) == ("groom", 24)
    write_drape(tmp_path / "drape.npz", drape(patch_of_strands((0.0, 1.0, 0.0))))
    found = summary_of(tmp_path / "drape.npz", body)
    assert (found["kind"], found["frames"], found["strands"]) == ("drape", 3, 150)
    weights = summary_of(Path(WEIGHTS), body)
    assert weights["kind"] == "weights"
    assert weights["parameters"] > 1000
    for name in ("obj", "npz motion"):
        suffix, (content, *_) = seeds()[name]
        (tmp_path / f"seed{suffix}").write_bytes(content)
        assert summary_of(tmp_path / f"seed{suffix}", body)["kind"] == {"obj": "head"}.get(name, "motion")
    with pytest.raises(InputError, match=r"a file that is read \(\.bvh, .*'\.jpg'"):
        summary_of(tmp_path / "hair.jpg", body)


def test_a_file_that_cannot_be_read_ends_with_one_line(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "hair.ply").write_bytes(b"plx")
    with pytest.raises(SystemExit) as stop:
        main(["inspect", str(tmp_path / "hair.ply")])
    assert stop.value.code == 2
    said = capfd.readouterr().err
    assert said.count("\n") == 1
    assert "expected a .ply file" in said
    with pytest.raises(SystemExit):
        main(["inspect", str(tmp_path / "hair.ply"), "--save-joints", str(tmp_path / "map.toml")])
    assert not (tmp_path / "map.toml").exists()


def test_a_body_file_and_bundled_names(tmp_path: Path, body: BodyModel) -> None:
    shipped = Path(str(files("quaffure") / "assets" / "body.npz"))
    found = summary_of(shipped, body)
    assert (found["kind"], found["joints"], found["vertices"]) == ("body", 27, len(body.rest_vertices))
    assert found["scalp_triangles"] == len(body.scalp.faces)
    assert summary_of(Path("nod"), body)["frames"] == 90
    assert summary_of(Path("crew_cut"), body)["kind"] == "groom"


@pytest.mark.parametrize("suffix", [pytest.param(".abc", marks=pytest.mark.slow), ".usd"])
def test_samples_of_an_animated_file(tmp_path: Path, body: BodyModel, suffix: str) -> None:
    pytest.importorskip({".abc": "alembic3d", ".usd": "pxr"}[suffix])
    clip = ExportClip(drape(patch_of_strands((0.0, 0.0, 1.0)), frames=5))
    write_output(tmp_path / f"hair{suffix}", clip)
    found = summary_of(tmp_path / f"hair{suffix}", body)
    assert (found["samples"], found["samples_a_second"]) == (5, clip.sequence.fps)
    if suffix == ".abc":
        assert "samples" not in summary_of(asset_path(tmp_path / "hair.abc"), body)


def test_text_is_no_alembic_file(tmp_path: Path, body: BodyModel) -> None:
    (tmp_path / "hair.abc").write_text("X:1\nT:a tune\n")
    with pytest.raises(InputError, match="found plain text"):
        summary_of(tmp_path / "hair.abc", body)
