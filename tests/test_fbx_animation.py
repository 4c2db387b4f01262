"""Animations of FBX files: curves of every kind, their layers, and weights of shapes."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quaffure import InputError
from quaffure.body import Character, poses_at
from tests.fbx_file import CONSTANT, CUBIC, LINEAR, TICKS, FbxFile, Record, listed
from tests.test_fbx import CUBE, QUADS, TRANSFORM, product, read

CONSTANT_NEXT, BY_TENSION = CONSTANT | 0x100, CUBIC | 0x200


def heights(found: Character, times: list[float], animation: int = 0) -> list[float]:
    """Places of the first model along x."""
    (poses,) = poses_at(found, found.animations[animation], np.array(times))
    return [round(float(x), 4) for x in poses.world[:, 1, 0, 3]]


def moving(times: list[float], values: list[float], flags: Any = LINEAR, slopes: Any = None) -> FbxFile:
    """A model that a curve moves along x."""
    file = FbxFile(unit=100.0)
    model = file.model("a", Lcl__Translation=(0.0, 1.0, 2.0))
    file.curve(file.curve_node(file.stack("moves"), model, "Lcl Translation"), "d|X", times, values, flags, slopes)
    return file


@pytest.mark.parametrize(
    ("flags", "expected"),
    [
        (LINEAR, [0, 0, 1, 2, 1, 0, 0]),
        (CONSTANT, [0, 0, 0, 2, 2, 0, 0]),
        (CONSTANT_NEXT, [0, 2, 2, 0, 0, 0, 0]),
        ([LINEAR, CONSTANT, LINEAR], [0, 0, 1, 2, 2, 0, 0]),
        (BY_TENSION, [0, 0, 1, 2, 1, 0, 0]),
    ],
)
def test_kinds_of_keys(flags: Any, expected: list[float], tmp_path: Path) -> None:
    found = read(moving([1, 2, 3], [0, 2, 0], flags), tmp_path)
    assert found.animations[0].span == (1.0, 3.0)
    assert heights(found, [0, 1, 1.5, 2, 2.5, 3, 4]) == expected


@pytest.mark.parametrize(("tag", "ticks"), [(0, 141_120_000), (127, TICKS), (None, TICKS)])
def test_ticks_of_a_second_are_those_that_the_header_names(tag: int | None, ticks: int, tmp_path: Path) -> None:
    file = moving([0.0], [0.0])
    curve = next(each for each in file.objects.children if each.name == "AnimationCurve")
    curve.child("KeyTime").properties = [np.int64([ticks, 3 * ticks])]
    curve.child("KeyValueFloat").properties = [np.float32([0, 1])]
    curve.child("KeyAttrRefCount").properties = [np.int32([2])]
    flags = [] if tag is None else [Record("TCDefinition", [tag])]
    file.header.children.append(Record("OtherFlags", [], flags))
    assert read(file, tmp_path, 7700).animations[0].span == (1.0, 3.0)


def test_clocks_that_nothing_is_known_of_are_refused(tmp_path: Path) -> None:
    file = moving([0, 1], [0, 2])
    file.header.children.append(Record("OtherFlags", [], [Record("TCDefinition", [5])]))
    with pytest.raises(InputError, match=r"TCDefinition at byte .*: expected 0 or 127, found 5"):
        read(file, tmp_path, 7700)


def test_cubic_keys_are_hermite_splines(tmp_path: Path) -> None:
    """x = t^3 - t of slopes 3 t^2 - 1, from keys half a second apart, which is what a cubic curve goes through."""
    keys = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
    slopes = np.stack([3 * keys**2 - 1, 3 * np.append(keys[1:], 0) ** 2 - 1], axis=1)
    found = read(moving(list(keys), list(keys**3 - keys), CUBIC, slopes), tmp_path)
    times = np.linspace(-1, 1, 41)
    np.testing.assert_allclose(heights(found, list(times)), times**3 - times, atol=5e-4)
    assert len(found.animations[0].channels[0].times) == 4 * 30 + 1


def test_keys_near_one_another_are_not_divided_nor_are_still_ones(tmp_path: Path) -> None:
    near = read(moving([0, 1 / 24, 2 / 24], [0, 1, 0]), tmp_path)
    assert len(near.animations[0].channels[0].times) == 3
    still = read(moving([0, 1000, 1000.05], [1, 1, 2]), tmp_path)
    assert len(still.animations[0].channels[0].times) == 3


def test_angles_turn_as_angles_do(tmp_path: Path) -> None:
    """Half a turn and more between two keys, which quaternions of the keys alone would not make."""
    file = FbxFile(unit=100.0)
    model = file.model("a", Lcl__Rotation=(0.0, 0.0, 45.0))
    curves = file.curve_node(file.stack("turns"), model, "Lcl Rotation", **{"d|Z": 30.0})
    file.curve(curves, "d|Y", [0, 2], [0, 720])
    found = read(file, tmp_path)
    times = np.linspace(0, 2, 61)
    (poses,) = poses_at(found, found.animations[0], times)
    angles = np.stack([0 * times, 360 * times, 30 + 0 * times], axis=1)
    expected = Rotation.from_euler("xyz", angles, degrees=True).as_matrix()
    np.testing.assert_allclose(poses.world[:, 1, :3, :3], expected, atol=0.01)


def test_pivots_of_a_rotation_move_the_origin(tmp_path: Path) -> None:
    file = FbxFile(unit=100.0)
    model = file.model("a", RotationActive=True, **(TRANSFORM | {"Lcl__Rotation": (0.0, 0.0, 0.0)}))
    curves = file.curve_node(file.stack("turns"), model, "Lcl Rotation")
    for axis, angle in zip("XYZ", TRANSFORM["Lcl__Rotation"]):
        file.curve(curves, f"d|{axis}", [0, 1], [0, angle])
    found = read(file, tmp_path)
    (poses,) = poses_at(found, found.animations[0], np.array([1.0]))
    np.testing.assert_allclose(poses.world[0, 1], product("xyz"), atol=1e-6)
    assert [channel.path for channel in found.animations[0].channels] == ["translation", "rotation"]


def test_layers_that_move_different_things_are_one_animation(tmp_path: Path) -> None:
    file = moving([0, 1], [0, 2])
    stack = next(each for each in file.objects.children if each.name == "AnimationStack").properties[0]
    layer = file.add("AnimationLayer", "", "more")
    file.connect(layer, stack)
    curves = file.curve_node(layer, 1001, "Lcl Scaling")
    file.curve(curves, "d|X", [0, 1], [1, 3])
    file.connect(file.add("AnimationLayer", "", "empty"), stack)
    file.stack("without anything")
    found = read(file, tmp_path)
    assert [(a.name, len(a.channels)) for a in found.animations] == [("moves", 2)]
    (poses,) = poses_at(found, found.animations[0], np.array([1.0]))
    assert poses.world[0, 1, 0].tolist() == pytest.approx([3, 0, 0, 2])
    file.curve(file.curve_node(layer, 1001, "Lcl Translation"), "d|Y", [0, 1], [1, 3])
    with pytest.raises(InputError, match=r"in one layer \(merge or bake its layers\) \(Model 'a'\), found two"):
        read(file, tmp_path)


def test_animations_of_one_file(tmp_path: Path) -> None:
    file = moving([0, 1], [0, 2])
    for name in ("moves", "Armature|run"):
        curves = file.curve_node(file.stack(name), 1001, "Lcl Translation", **{"d|Y": 7.0})
        file.curve(curves, "d|X", [0, 1], [5, 5])
    found = read(file, tmp_path)
    assert [animation.name for animation in found.animations] == ["moves", "moves#2", "Armature|run"]
    assert heights(found, [0.5]) == [1]
    assert heights(found, [0.5], 1) == [5]
    (pose,) = poses_at(found, found.animations[1], np.array([0.0]))
    assert pose.world[0, 1, :3, 3].tolist() == [5, 7, 2]


def test_curves_of_sliders_are_weights_of_shapes(tmp_path: Path) -> None:
    file = FbxFile(unit=100.0)
    geometry = file.geometry(file.model("a"), CUBE, QUADS)
    blend = file.add("Deformer", "BlendShape", "shapes")
    file.connect(blend, geometry)
    layer = file.stack("talks")
    for name, times in (("a", [0.0, 0.05]), ("b", [0.05, 0.1]), ("still", [])):
        channel = file.add("Deformer", "BlendShapeChannel", name, listed(DeformPercent=50.0),
                           Record("FullWeights", [np.array([100.0])]))  # fmt: skip
        shape = file.add("Geometry", "Shape", name, Record("Indexes", [np.int32([5])]),
                         Record("Vertices", [np.float64([0, 1, 0])]))  # fmt: skip
        file.connect(channel, blend)
        file.connect(shape, channel)
        if times:
            curves = file.curve_node(layer, channel, "DeformPercent")
            file.curve(curves, "d|DeformPercent", times, [0.0, 100.0])
    found = read(file, tmp_path)
    (channel,) = found.animations[0].channels
    assert (channel.path, found.nodes.names[channel.node]) == ("weights", "a")
    (poses,) = poses_at(found, found.animations[0], np.array([0, 0.05, 0.1]))
    np.testing.assert_allclose(poses.morph_weights[1], [[0, 0, 0.5], [1, 0, 0.5], [1, 1, 0.5]], atol=1e-6)


@pytest.mark.parametrize("how", [0, 2])
def test_scales_that_move_above_models_that_do_not_take_them_on(how: int, tmp_path: Path) -> None:
    file = FbxFile(unit=100.0)
    parent = file.model("a", file.model("above"))
    file.model("b", parent, InheritType=how)
    curves = file.curve_node(file.stack("grows"), parent, "Lcl Scaling")
    for axis in "XYZ":
        file.curve(curves, f"d|{axis}", [0, 1], [1, 2])
    expected = r"a scale that does not move above a model of InheritType 2 \(Model 'a'\)"
    if how == 0:
        (pose,) = poses_at(read(file, tmp_path), read(file, tmp_path).animations[0], np.array([1.0]))
        assert np.diag(pose.world[0, 3]).tolist() == [2, 2, 2, 1]
        file.curve(file.curve_node(file.stack("grows aside"), 1001, "Lcl Scaling"), "d|X", [0, 1], [1, 2])
        expected = r"the same scale along all axes above a model of InheritType 0 or 2 \(Model 'above'\)"
    with pytest.raises(InputError, match=expected):
        read(file, tmp_path)
