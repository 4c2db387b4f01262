"""The body: its asset, its skinning against the source model's, its closed surface, its gradients.

`data/anny_poses.npz` was made by `python scripts/bake_body.py --golden`: six random bodies of our shape space in
six random poses (0.5 rad a component), through the kinematics and the skinning of Anny 0.6.2 itself, with Anny's own
bone orientations; every eighth vertex, and every joint.
"""

import io
import zipfile
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
import torch

from quaffure import InputError
from quaffure.body import BodyModel, load_body
from quaffure.body.body_model import FILE_ARRAYS
from quaffure.geometry import matrix_from_axis_angle

ASSET = Path(str(files("quaffure") / "assets" / "body.npz"))
GOLDEN = Path(__file__).parent / "data" / "anny_poses.npz"


@pytest.fixture(scope="module")
def body() -> BodyModel:
    return load_body()


@pytest.fixture(scope="module")
def golden() -> dict[str, torch.Tensor]:
    with np.load(GOLDEN, allow_pickle=False) as arrays:
        return {name: torch.from_numpy(arrays[name]) for name in arrays.files}


def test_skinning_agrees_with_the_source_model(body: BodyModel, golden: dict[str, torch.Tensor]) -> None:
    posed = body.pose(golden["body_pose"], golden["body_shape"])
    distance = (posed.vertices[:, ::8] - golden["vertices"]).norm(dim=-1)
    assert distance.max() < 1e-3 / 10  # of the 1 mm that is asked for
    torch.testing.assert_close(posed.joint_positions, golden["joint_positions"], atol=1e-4, rtol=0)


def test_joints_alone_are_those_of_the_posed_body(body: BodyModel, golden: dict[str, torch.Tensor]) -> None:
    pose, shape = golden["body_pose"], golden["body_shape"]
    posed = body.pose(pose, shape)
    rotations, positions = body.posed_joints(pose, shape)
    torch.testing.assert_close(rotations, posed.joint_rotations)
    torch.testing.assert_close(positions, posed.joint_positions)


def test_rest_pose_is_the_rest_body(body: BodyModel) -> None:
    shape = torch.linspace(-2, 2, 10)[None]
    posed = body.pose(torch.zeros(1, 81), shape)
    vertices, joints = body.rest(shape)
    torch.testing.assert_close(posed.vertices, vertices, atol=1e-5, rtol=0)
    torch.testing.assert_close(posed.joint_positions, joints, atol=1e-6, rtol=0)
    torch.testing.assert_close(posed.joint_rotations, torch.eye(3).expand(1, 27, 3, 3))


def test_turning_the_root_turns_the_whole_body_about_it(body: BodyModel) -> None:
    pose = torch.zeros(1, 81)
    pose[0, :3] = torch.tensor([0.3, -0.5, 0.9])
    shape = torch.zeros(1, 10)
    turn, root = matrix_from_axis_angle(pose[0, :3]), body.rest_joints[0]
    expected = (body.rest_vertices - root) @ turn.T + root
    torch.testing.assert_close(body.pose(pose, shape).vertices[0], expected, atol=1e-5, rtol=0)


def test_skeleton_has_the_27_joints_of_the_paper(body: BodyModel) -> None:
    assert len(body.joint_names) == len(body.joint_parents) == len(body.rest_joints) == 27
    assert len(set(body.joint_names)) == 27
    parent_of = {name: body.joint_parents[i] for i, name in enumerate(body.joint_names)}
    assert [body.joint_names[parent_of[name]] for name in ("Head", "Neck1", "Neck")] == ["Neck1", "Neck", "Spine1"]
    left, right = (body.rest_joints[body.joint_names.index(name)] for name in ("LeftArm", "RightArm"))
    assert left[0] > 0.1 > -0.1 > right[0]


def test_skin_weights_share_each_vertex_out(body: BodyModel) -> None:
    torch.testing.assert_close(body.skin_weights.sum(-1), torch.ones(len(body.rest_vertices)), atol=1e-5, rtol=0)
    assert body.skin_weights.min() >= 0


def test_surface_is_one_closed_piece_with_normals_outwards(body: BodyModel) -> None:
    faces = body.faces.numpy()
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64)
    count = len(body.rest_vertices)
    directed = edges[:, 0] * count + edges[:, 1]
    assert len(np.unique(directed)) == len(directed)
    assert np.array_equal(np.sort(directed), np.sort(edges[:, 1] * count + edges[:, 0]))
    assert count - len(edges) // 2 + len(faces) == 2  # Euler characteristic of a sphere
    assert len(np.unique(faces)) == count
    label = np.arange(count)
    while True:  # the least label spreads over each piece
        spread = label.copy()
        np.minimum.at(spread, edges[:, 0], label[edges[:, 1]])
        spread = spread[spread]
        if np.array_equal(spread, label):
            break
        label = spread
    assert (label == 0).all()
    a, b, c = body.rest_vertices.double()[body.faces].unbind(1)
    volume = (torch.linalg.cross(a, b) * c).sum() / 6
    assert 0.05 < volume < 0.12  # m^3


def test_rest_body_stands_on_the_ground_and_faces_minus_y(body: BodyModel) -> None:
    low, high = body.rest_vertices.amin(0), body.rest_vertices.amax(0)
    assert abs(low[2]) < 1e-6
    assert 1.6 < high[2] < 2.0
    head = body.rest_vertices[body.rest_vertices[:, 2] > body.rest_joints[body.joint_names.index("Head"), 2]]
    assert head[head[:, 1].argmin(), 0].abs() < 5e-3  # the nose
    toe, foot = (body.rest_joints[body.joint_names.index(name)] for name in ("LeftToeBase", "LeftFoot"))
    assert toe[1] < foot[1] - 0.1


def test_each_shape_coefficient_moves_the_body(body: BodyModel) -> None:
    moved = body.pose(torch.zeros(10, 81), torch.eye(10)).vertices - body.rest_vertices
    largest = moved.norm(dim=-1).amax(-1)
    assert (largest > 2e-3).all()
    assert largest[0] == largest.max()


def test_gradients_reach_pose_and_shape(body: BodyModel) -> None:
    double = body.to("cpu", torch.float64)
    generator = torch.Generator().manual_seed(0)
    picked = torch.randint(len(body.rest_vertices), (40,), generator=generator)
    pose = (0.4 * torch.randn(1, 81, generator=generator, dtype=torch.float64)).requires_grad_()
    shape = torch.randn(1, 10, generator=generator, dtype=torch.float64).requires_grad_()

    def height(pose: torch.Tensor, shape: torch.Tensor) -> torch.Tensor:
        return double.pose(pose, shape).vertices[:, picked].square().sum()

    height(pose, shape).backward()
    assert pose.grad is not None
    assert shape.grad is not None
    assert pose.grad.norm() > 0.1
    assert shape.grad.norm() > 0.1
    for leaf, direction in ((pose, torch.ones_like(pose)), (shape, torch.ones_like(shape))):
        step = 1e-6 * direction
        with torch.no_grad():
            ahead = height(*(x + step if x is leaf else x for x in (pose, shape)))
            behind = height(*(x - step if x is leaf else x for x in (pose, shape)))
        torch.testing.assert_close((ahead - behind) / 2e-6, (leaf.grad * direction).sum(), atol=1e-6, rtol=1e-6)


def test_asset_is_small() -> None:
    assert ASSET.stat().st_size <= 3_000_000
    assert GOLDEN.stat().st_size <= 300_000


def _rewritten(tmp_path: Path, **changes: np.ndarray | None) -> Path:
    with np.load(ASSET, allow_pickle=False) as arrays:
        content = {**{name: arrays[name] for name in arrays.files}, **changes}
    path = tmp_path / "body.npz"
    np.savez(path, **{name: array for name, array in content.items() if array is not None})
    return path


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"faces": None}, "no array faces"),
        ({"rest_joints": np.zeros((26, 3), np.float32)}, "rest_joints of shape"),
        ({"skin_weights": np.zeros((5, 7), np.float32)}, "skin_weights of shape"),
        ({"rest_joints": np.full((27, 3), np.nan, np.float32)}, "finite rest_joints"),
        ({"faces": np.full((4, 3), 10**6, np.int32)}, "below 12408 in faces"),
        ({"joint_parents": np.arange(27, dtype=np.int32)}, "parents"),
    ],
)
def test_a_contradictory_file_is_refused(tmp_path: Path, changes: dict[str, np.ndarray | None], message: str) -> None:
    with pytest.raises(InputError, match=message):
        load_body(_rewritten(tmp_path, **changes))


def test_files_of_other_kinds_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        load_body(tmp_path / "missing.npz")
    (tmp_path / "text.npz").write_text("no archive")
    with pytest.raises(InputError, match=r"text\.npz"):
        load_body(tmp_path / "text.npz")
    with pytest.raises(InputError, match=r"body import.*found a character"):
        load_body(tmp_path / "anna.GLB")


def test_a_body_is_printed_in_a_line(body: BodyModel) -> None:
    assert (
        repr(body)
        == f"BodyModel ({len(body.rest_vertices)} vertices, 27 joints, {len(body.scalp.faces)} triangles of scalp)"
    )


def test_a_header_that_promises_more_than_the_file_holds_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "huge.npz"
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f4", "fortran_order": False, "shape": (2**40, 3)})
    with zipfile.ZipFile(path, "w") as archive:
        for name in FILE_ARRAYS:
            archive.writestr(f"{name}.npy", header.getvalue())
    with pytest.raises(InputError, match="rest_vertices"):
        load_body(path)
