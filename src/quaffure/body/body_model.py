"""The body: ten shape coefficients and 27 joint rotations to a posed surface, by linear blend skinning."""

from dataclasses import dataclass, fields, replace
from functools import cache, cached_property
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from quaffure.body.body_origin import BodyOrigin
from quaffure.body.pose_limits import JOINT_COUNT, SHAPE_COUNT, Rows, check_body_pose, check_body_shape, rows_of
from quaffure.body.scalp import ScalpChart
from quaffure.errors import InputError
from quaffure.geometry.rotation import matrix_from_axis_angle
from quaffure.geometry.surface import Surface, SurfaceTopology, posed_surface, surface_topology
from quaffure.npz import INTEGER, REAL, TEXT, Spec, read_arrays
from quaffure.types import BodyPose, BodyShape, MeshFaces

CHARACTERS = (".glb", ".gltf", ".fbx")
"""Files that a body is often mistaken for."""

FILE_ARRAYS: Spec = {
    "rest_vertices": (("v", 3), REAL),
    "shape_directions": ((SHAPE_COUNT, "v", 3), INTEGER),
    "shape_direction_scales": ((SHAPE_COUNT,), REAL),
    "rest_joints": ((JOINT_COUNT, 3), REAL),
    "joint_shape_directions": ((SHAPE_COUNT, JOINT_COUNT, 3), REAL),
    "joint_parents": ((JOINT_COUNT,), INTEGER),
    "joint_names": ((JOINT_COUNT,), TEXT),
    "skin_joints": (("v", "w"), INTEGER),
    "skin_weights": (("v", "w"), REAL),
    "faces": (("k", 3), INTEGER),
    "ear_vertices": (("e",), INTEGER),
    "scalp_faces": (("f",), INTEGER),
    "scalp_uv": (("f", 3, 2), REAL),
    "meta": ((), TEXT),
}
ORIGIN_ARRAYS: Spec = {
    "file_from_body_scale": ((), REAL),
    "file_from_body_rotation": ((3, 3), REAL),
    "file_from_body_translation": ((3,), REAL),
    "file_name": ((), TEXT),
    "file_digest": ((), TEXT),
    "file_joint_nodes": ((JOINT_COUNT,), TEXT),
}
"""Arrays that an imported body has besides (`BodyOrigin`)."""


@dataclass(frozen=True)
class PosedBody:
    """Posed bodies in the world.

    Attributes:
        vertices: surface vertices [m].
        joint_rotations: `world_from_joint`; the identity in the rest pose, whatever the bone's direction.
        joint_positions: [m].
    """

    vertices: Float[Tensor, "b v 3"]
    joint_rotations: Float[Tensor, "b j 3 3"]
    joint_positions: Float[Tensor, "b j 3"]


@dataclass(frozen=True, eq=False)
class BodyModel:
    """A family of bodies: rest surface and skeleton, linear in the shape, skinned to 27 joints.

    At rest the body stands in an A pose on the ground z = 0 (mean shape), facing -y, its left on +x. Poses are
    axis-angles in world-aligned rest frames: joint j rotates by R_j relative to its parent, `G_j = G_parent R_j`,
    about its own rest position J_j; the root Hips stays at its rest position. There is no global translation.

    Attributes:
        rest_vertices: surface of the mean shape [m].
        shape_directions: its change per coefficient [m]; a coefficient of 1 is one standard deviation of adults.
        rest_joints, joint_shape_directions: the same for the joints [m].
        joint_parents: index of each joint's parent, -1 for the root; parents come first.
        joint_names: names in the CMU skeleton.
        skin_joints, skin_weights: joints that move each vertex, and their shares, which sum to 1.
        faces: triangles of the closed surface, normals outwards.
        ear_vertices: the vertices of both ears.
        scalp: the part of the surface with hair.
        meta: source, licence, seed and units, as JSON.
        origin: the character file that it was imported from; None for a body that was not.
    """

    rest_vertices: Float[Tensor, "v 3"]
    shape_directions: Float[Tensor, "10 v 3"]
    rest_joints: Float[Tensor, "27 3"]
    joint_shape_directions: Float[Tensor, "10 27 3"]
    joint_parents: tuple[int, ...]
    joint_names: tuple[str, ...]
    skin_joints: Int[Tensor, "v w"]
    skin_weights: Float[Tensor, "v w"]
    faces: MeshFaces
    ear_vertices: Int[Tensor, " e"]
    scalp: ScalpChart
    meta: str
    origin: BodyOrigin | None = None

    def __repr__(self) -> str:
        """A line: the arrays of the generated text are 30 kB."""
        of = "" if self.origin is None else f" of {self.origin.source}"
        counts = f"{len(self.rest_vertices)} vertices, {len(self.joint_names)} joints"
        return f"BodyModel{of} ({counts}, {len(self.scalp.faces)} triangles of scalp)"

    def to(self, device: torch.device | str, dtype: torch.dtype | None = None) -> "BodyModel":
        """The same body on a device, its real numbers in `dtype` (float64 in gradient checks).

        A body that is there already is returned itself, with what has been computed of it.
        """
        moved: dict[str, Any] = {}
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, Tensor):
                moved[field.name] = value.to(device, dtype if value.is_floating_point() else None)
        if all(moved[name] is getattr(self, name) for name in moved):
            return self
        return replace(self, scalp=self.scalp.to(device), **moved)

    def rest(self, body_shape: BodyShape) -> tuple[Float[Tensor, "b v 3"], Float[Tensor, "b j 3"]]:
        """Surface and joints of shaped bodies in the rest pose [m]."""
        count = len(body_shape)
        vertices = torch.addmm(self.rest_vertices.flatten(), body_shape, self.shape_directions.flatten(1))
        return vertices.view(count, -1, 3), self.shaped_joints(body_shape)

    def shaped_joints(self, body_shape: BodyShape) -> Float[Tensor, "b j 3"]:
        """Joints of shaped bodies in the rest pose [m]."""
        joints = torch.addmm(self.rest_joints.flatten(), body_shape, self.joint_shape_directions.flatten(1))
        return joints.view(len(body_shape), -1, 3)

    def posed_joints(
        self, body_pose: BodyPose, body_shape: BodyShape
    ) -> tuple[Float[Tensor, "b j 3 3"], Float[Tensor, "b j 3"]]:
        """Forward kinematics alone: `world_from_joint` rotations and joint positions [m]."""
        return self.forward_kinematics(body_pose, self.shaped_joints(body_shape))

    def pose(self, body_pose: Rows, body_shape: Rows) -> PosedBody:
        """Bodies of shape beta [standard deviations] in pose theta [rad]; differentiable in tensors.

        Args:
            body_pose: [batch, 81].
            body_shape: [batch, 10].

        Raises:
            InputError: other shapes, numbers that are not finite, a rotation beyond 4 pi, or a coefficient beyond 10.
        """
        poses, shapes = self.checked_pose_and_shape(body_pose, body_shape)
        return self.skin(shapes, *self.posed_joints(poses, shapes))

    def checked_pose_and_shape(self, body_pose: Rows, body_shape: Rows) -> tuple[Tensor, Tensor]:
        """Validated poses and shapes as tensors; the numbers of rows may differ. Arguments and errors as of `pose`."""
        poses = rows_of(body_pose, 3 * JOINT_COUNT, self.rest_vertices, "body_pose")
        shapes = rows_of(body_shape, SHAPE_COUNT, self.rest_vertices, "body_shape")
        check_body_pose(poses, "body_pose")
        check_body_shape(shapes, "body_shape")
        return poses, shapes

    def skin(
        self,
        body_shape: BodyShape,
        rotations: Float[Tensor, "b j 3 3"],
        positions: Float[Tensor, "b j 3"],
        offsets: Float[Tensor, "b v 3"] | None = None,
    ) -> PosedBody:
        """Bodies of shape beta [standard deviations] whose joints are posed, by linear blend skinning.

        Args:
            offsets: added to the vertices at rest [m].
        """
        rest_vertices, rest_joints = self.rest(body_shape)
        if offsets is not None:
            check_offsets(offsets, self, len(rotations))
            rest_vertices = rest_vertices + offsets
        # x -> G_j (x - J_j) + p_j as one 3x4 matrix a joint, blended by the skin weights; vertices go last, where
        # products over them run through contiguous memory.
        translations = positions[..., None] - rotations @ rest_joints[..., None]
        transforms = torch.cat([rotations, translations], dim=-1).flatten(2)
        blended = (transforms.transpose(1, 2) @ self.dense_skin_weights.T).unflatten(1, (3, 4))
        turned = (blended[:, :, :3] * rest_vertices.transpose(1, 2)[:, None]).sum(2)
        return PosedBody((turned + blended[:, :, 3]).transpose(1, 2).contiguous(), rotations, positions)

    def forward_kinematics(
        self, body_pose: BodyPose, rest_joints: Float[Tensor, "b j 3"]
    ) -> tuple[Float[Tensor, "b j 3 3"], Float[Tensor, "b j 3"]]:
        """`posed_joints` of bodies whose joints at rest are known [m]."""
        local = matrix_from_axis_angle(body_pose.unflatten(-1, (JOINT_COUNT, 3)))
        bones = rest_joints - rest_joints[:, self._parent_index]
        steps = torch.cat([local, bones[..., None]], dim=-1).unbind(1)
        rotations, positions = [local[:, 0]], [rest_joints[:, 0]]
        for joint, parent in enumerate(self.joint_parents[1:], start=1):
            step = rotations[parent] @ steps[joint]
            rotations.append(step[..., :3])
            positions.append(positions[parent] + step[..., 3])
        return torch.stack(rotations, dim=1), torch.stack(positions, dim=1)

    @cached_property
    def surface_topology(self) -> SurfaceTopology:
        """Search structure over the closed surface, shared by all poses."""
        return surface_topology(self.rest_vertices, self.faces)

    @cached_property
    def rest_surface(self) -> Surface:
        """The mean body in its rest pose, ready for nearest-face searches."""
        return posed_surface(self.surface_topology, self.rest_vertices[None])

    @cached_property
    def _parent_index(self) -> Int[Tensor, "27"]:
        """Parents as a tensor; the root stands for its own, and its bone is zero."""
        return torch.tensor((0, *self.joint_parents[1:]), device=self.rest_joints.device)

    @cached_property
    def dense_skin_weights(self) -> Float[Tensor, "v 27"]:
        """Share of every joint in every vertex.

        One matrix product blends all vertices faster than indexing the joints of each.
        """
        dense = self.skin_weights.new_zeros(len(self.skin_weights), JOINT_COUNT)
        return dense.scatter_add_(1, self.skin_joints, self.skin_weights)


def check_offsets(offsets: Float[Tensor, "b v 3"], body: BodyModel, batch: int) -> None:
    """Refuse changes of a surface that is not that of these bodies: arrays of one body would be added to all.

    Raises:
        InputError: another number of bodies or of vertices.
    """
    expected = [batch, len(body.rest_vertices), 3]
    if list(offsets.shape) != expected:
        raise InputError("offsets", f"{expected}", f"{list(offsets.shape)}")


def load_body(path: str | Path | None = None) -> BodyModel:
    """The body that the package ships, or one of a file: imported from a character (`quaffure body import`) or baked
    (`scripts/bake_body.py`).

    The shipped one is the same object every time: what is prepared for a groom on a body is kept by the body.

    Raises:
        InputError: the file is missing, is no body file, or its arrays contradict each other.
    """
    return _shipped_body() if path is None else _read_body(Path(path))


@cache
def _shipped_body() -> BodyModel:
    return _read_body(Path(str(files("quaffure") / "assets" / "body.npz")))


def _read_body(path: Path) -> BodyModel:
    if path.suffix.lower() in CHARACTERS:
        expected = "a body file (.npz), which `quaffure body import` makes of a character"
        raise InputError(path, expected, "a character")
    arrays, sizes = read_arrays(path, FILE_ARRAYS, "a body file (.npz)", ORIGIN_ARRAYS)
    _check_indices(arrays, sizes, path)
    with np.errstate(over="ignore", invalid="ignore"):
        directions = arrays["shape_directions"].astype(np.float32) * arrays["shape_direction_scales"][:, None, None]
    if not np.isfinite(directions).all():
        raise InputError(path, "shape directions within single precision", "larger ones")
    return BodyModel(
        rest_vertices=torch.from_numpy(arrays["rest_vertices"]),
        shape_directions=torch.from_numpy(directions),
        rest_joints=torch.from_numpy(arrays["rest_joints"]),
        joint_shape_directions=torch.from_numpy(arrays["joint_shape_directions"]),
        joint_parents=tuple(arrays["joint_parents"].tolist()),
        joint_names=tuple(arrays["joint_names"].tolist()),
        skin_joints=torch.from_numpy(arrays["skin_joints"].astype(np.int64)),
        skin_weights=torch.from_numpy(arrays["skin_weights"]),
        faces=torch.from_numpy(arrays["faces"].astype(np.int64)),
        ear_vertices=torch.from_numpy(arrays["ear_vertices"].astype(np.int64)),
        scalp=ScalpChart(
            torch.from_numpy(arrays["scalp_faces"].astype(np.int64)), torch.from_numpy(arrays["scalp_uv"])
        ),
        meta=str(arrays["meta"]),
        origin=_origin(arrays, path),
    )


def _origin(arrays: dict[str, np.ndarray], path: Path) -> BodyOrigin | None:
    missing = [name for name in ORIGIN_ARRAYS if name not in arrays]
    if missing:
        if len(missing) < len(ORIGIN_ARRAYS):
            raise InputError(path, f"all or none of the arrays {', '.join(ORIGIN_ARRAYS)}", f"no {missing[0]}")
        return None
    rotation, scale = arrays["file_from_body_rotation"].astype(float), float(arrays["file_from_body_scale"])
    if not scale > 0 or np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-4 or np.linalg.det(rotation) < 0:
        raise InputError(path, "a rotation and a positive scale to the file's space", f"{rotation.tolist()}, {scale}")
    return BodyOrigin(
        scale=scale,
        rotation=rotation,
        translation=arrays["file_from_body_translation"].astype(float),
        source=str(arrays["file_name"]),
        digest=str(arrays["file_digest"]),
        joint_nodes=tuple(arrays["file_joint_nodes"].tolist()),
    )


def _check_indices(arrays: dict[str, np.ndarray], sizes: dict[str, int], path: Path) -> None:
    vertices, faces = sizes["v"], sizes["k"]
    for name, bound in {"faces": vertices, "ear_vertices": vertices, "scalp_faces": faces, "skin_joints": 27}.items():
        if arrays[name].size and not (arrays[name].min() >= 0 and arrays[name].max() < bound):
            raise InputError(path, f"indices below {bound} in {name}", f"{arrays[name].min()}..{arrays[name].max()}")
    parents = arrays["joint_parents"]
    if parents[0] != -1 or not ((parents[1:] >= 0) & (parents[1:] < np.arange(1, JOINT_COUNT))).all():
        raise InputError(path, "joints listed after their parents, root first", f"parents {parents.tolist()}")
