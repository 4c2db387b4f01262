from pathlib import Path

import numpy as np
import pytest

from quaffure import InputError
from quaffure.io import read_bvh

TWO_JOINTS = """\
HIERARCHY
ROOT hip
{
  OFFSET 0 1 2
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT upper arm
  {
    OFFSET 3 4 5
    CHANNELS 3 Zrotation Yrotation Xrotation
    End Site
    {
      OFFSET 1 0 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.025
10 20 30 0 0 0 0 0 0
11 21 31 90 0 0 90 90 0
"""


@pytest.fixture
def bvh_path(tmp_path: Path) -> Path:
    path = tmp_path / "clip.bvh"
    path.write_text(TWO_JOINTS)
    return path


def test_reads_every_field(bvh_path: Path) -> None:
    clip = read_bvh(bvh_path)
    assert clip.joint_names == ("hip", "upper arm")
    assert clip.parents.tolist() == [-1, 0]
    assert clip.offsets.tolist() == [[0, 1, 2], [3, 4, 5]]
    assert clip.channels[1] == ("Zrotation", "Yrotation", "Xrotation")
    assert clip.values.tolist() == [[10, 20, 30, 0, 0, 0, 0, 0, 0], [11, 21, 31, 90, 0, 0, 90, 90, 0]]
    assert clip.fps == pytest.approx(40)


def test_first_channel_turns_last(bvh_path: Path) -> None:
    """Rz(90) Ry(90) takes x to -z under Ry, which Rz leaves; the other order would end at y."""
    clip = read_bvh(bvh_path)
    np.testing.assert_allclose(clip.local_rotations()[1, 1] @ [1, 0, 0], [0, 0, -1], atol=1e-12)


def test_world_rotations_accumulate_from_the_root(bvh_path: Path) -> None:
    world = read_bvh(bvh_path).world_rotations()
    np.testing.assert_allclose(world[0], np.tile(np.eye(3), (2, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(world[1, 0] @ [1, 0, 0], [0, 1, 0], atol=1e-12)
    # The arm's own Ry takes z to x and its Rz that to y, which the root's Rz takes to -x.
    np.testing.assert_allclose(world[1, 1] @ [0, 0, 1], [-1, 0, 0], atol=1e-12)


def test_windows_line_ends_tabs_blank_lines_and_other_case(tmp_path: Path, bvh_path: Path) -> None:
    text = TWO_JOINTS.replace("Frames: 2", "Frames:\t2").replace("MOTION", "Motion").replace("Zrotation", "ZRotation")
    path = tmp_path / "other.bvh"
    path.write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "\r\n\r\n").encode())
    np.testing.assert_array_equal(read_bvh(path).values, read_bvh(bvh_path).values)
    assert read_bvh(path).channels == read_bvh(bvh_path).channels


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("11 21 31 90 0 0 90 90 0\n", "", r"line 19: expected 2 lines of values.*found 1"),
        ("11 21 31 90 0 0 90 90 0", "11 21 31 90 0 0 90 90", r"line 20: expected 9 channel values, found 8"),
        ("11 21 31", "11 nan 31", r"line 20: expected finite numbers, found 'nan'"),
        ("11 21 31", "11 x 31", r"line 20: expected numbers, found 'x'"),
        ("MOTION\n", "", r"line 16: expected MOTION, found 'Frames: 2'"),
        ("Frames: 2", "Frames: 0", r"line 17: expected Frames: and a number above 0"),
        ("Frames: 2", "Frames: -2", r"line 17: expected Frames: and a number above 0"),
        ("Frames: 2", "Frames: 99999999999999", r"line 20: expected 99999999999999 lines of values"),
        ("Time: 0.025", "Time: 0", r"line 18: expected a frame time above 0 s"),
        ("Time: 0.025", "Time: -0.1", r"line 18: expected a frame time above 0 s"),
        ("Time: 0.025", "Time: inf", r"line 18: expected finite numbers"),
        ("OFFSET 3 4 5", "OFFSET 3 4", r"line 8: expected OFFSET x y z"),
        ("CHANNELS 3 Z", "CHANNELS 4 Z", r"line 9: expected 4 channel names, found 3"),
        ("CHANNELS 3 Z", "CHANNELS 3 Q", r"line 9: expected different channels"),
        ("upper arm", "hip", r"line 6: expected joint names that differ"),
        ("HIERARCHY", "HIERARCHIE", r"line 1: expected HIERARCHY"),
        (TWO_JOINTS[120:], "", r"expected .* found the end of the file"),
        (TWO_JOINTS, "", r"line 1: expected HIERARCHY, found the end of the file"),
    ],
)
def test_malformed_files_name_the_line(bvh_path: Path, old: str, new: str, message: str) -> None:
    assert old in TWO_JOINTS
    bvh_path.write_text(TWO_JOINTS.replace(old, new))
    with pytest.raises(InputError, match=message):
        read_bvh(bvh_path)


def test_bytes_that_are_not_text(bvh_path: Path) -> None:
    bvh_path.write_bytes(b"HIERARCHY\n\xff\xfe\x00")
    with pytest.raises(InputError, match="not text"):
        read_bvh(bvh_path)


def test_a_very_deep_hierarchy_is_no_trap(bvh_path: Path) -> None:
    joints = "".join(f"JOINT j{i}\n{{\nOFFSET 0 0 0\nCHANNELS 1 Xrotation\n" for i in range(3000))
    bvh_path.write_text(
        "HIERARCHY\n"
        + joints.replace("JOINT", "ROOT", 1)
        + "}\n" * 3000
        + f"MOTION\nFrames: 1\nFrame Time: 1\n{'0 ' * 3000}\n"
    )
    assert len(read_bvh(bvh_path).joint_names) == 3000


@pytest.mark.shared_data
@pytest.mark.parametrize(("name", "frames"), [("07_01", 317), ("06_14", 480), ("13_26", 3029)])
def test_reads_real_clips(shared_data: Path, name: str, frames: int) -> None:
    clip = read_bvh(shared_data / f"motion/{name}.bvh")
    assert clip.values.shape == (frames, 132)
    assert clip.fps == pytest.approx(120, rel=1e-4)
