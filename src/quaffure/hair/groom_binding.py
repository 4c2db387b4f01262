"""What binds a groom to a body in other programs: both at rest, and texture coordinates that they share."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from quaffure.body.body_model import BodyModel
from quaffure.body.pose_limits import Rows, shape_of
from quaffure.hair.groom import Groom
from quaffure.hair.posing import posed_strands

BODY_TILE = 1.0
"""First u of the tile (UDIM 1002) of the skin off the scalp, whose own chart fills the tile from 0 to 1 (1001)."""


@dataclass(frozen=True)
class Skeleton:
    """Joints of a shaped body in the rest pose, whose frames are the world's, and how they move the skin.

    Attributes:
        names: parents come first.
        parents: index of each joint's parent, -1 for the root.
        rest_joints: positions [m].
        skin_joints, skin_weights: joints that move each vertex of the body, and their shares, which sum to 1.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    rest_joints: Float[np.ndarray, "j 3"]
    skin_joints: Int[np.ndarray, "v w"]
    skin_weights: Float[np.ndarray, "v w"]

    def posed(
        self, body_pose: Float[np.ndarray, "j 3"], translation: Float[np.ndarray, "3"]
    ) -> tuple[Float[np.ndarray, "j 3 3"], Float[np.ndarray, "j 3"]]:
        """`world_from_joint` rotations and positions of the joints in a pose [rad] of a body that has moved [m]."""
        local = Rotation.from_rotvec(body_pose).as_matrix()
        rotations, positions = np.empty_like(local), np.empty_like(self.rest_joints)
        for joint, parent in enumerate(self.parents):
            if parent < 0:
                rotations[joint], positions[joint] = local[joint], self.rest_joints[joint] + translation
                continue
            bone = self.rest_joints[joint] - self.rest_joints[parent]
            rotations[joint] = rotations[parent] @ local[joint]
            positions[joint] = positions[parent] + rotations[parent] @ bone
        return rotations, positions


@dataclass(frozen=True)
class GroomBinding:
    """A groom and a shaped body in the rest pose.

    Attributes:
        strands: guides at rest [m, world].
        body_vertices: [m, world].
        root_uv: position of every root on the scalp chart.
        body_uv: texture coordinates of every corner of the body's faces: the scalp chart on the scalp, where they agree
            with `root_uv`, and a cylinder around the body in the next tile elsewhere.
        skeleton: of the body.
    """

    strands: Float[np.ndarray, "s n 3"]
    body_vertices: Float[np.ndarray, "v 3"]
    root_uv: Float[np.ndarray, "s 2"]
    body_uv: Float[np.ndarray, "k 3 2"]
    skeleton: Skeleton


def groom_binding(groom: Groom, body: BodyModel, body_shape: Rows) -> GroomBinding:
    """The groom on the body of a shape, in the rest pose.

    Args:
        groom: registered to `body`.
        body_shape: beta [10], a tensor, an array or a list [standard deviations].

    Raises:
        InputError: no such shape.
    """
    shape = shape_of(body_shape)[None].to(body.rest_vertices)
    rest = body.pose(torch.zeros(1, 3 * len(body.joint_names)), shape)
    return GroomBinding(
        strands=posed_strands(groom, rest, body)[0].numpy(),
        body_vertices=rest.vertices[0].numpy(),
        root_uv=groom.root_uv.numpy(),
        body_uv=body_uv(body),
        skeleton=Skeleton(
            body.joint_names,
            body.joint_parents,
            body.shaped_joints(shape)[0].double().numpy(),
            body.skin_joints.numpy(),
            body.skin_weights.numpy(),
        ),
    )


def body_uv(body: BodyModel) -> Float[np.ndarray, "k 3 2"]:
    """Texture coordinates of every corner of the faces (`GroomBinding.body_uv`)."""
    vertices, faces = body.rest_vertices.numpy(), body.faces.numpy()
    middle = vertices.mean(axis=0)
    around = np.arctan2(vertices[:, 0] - middle[0], middle[1] - vertices[:, 1]) / (2 * np.pi) + 0.5
    height = (vertices[:, 2] - vertices[:, 2].min()) / np.ptp(vertices[:, 2])
    corners = around[faces]
    # Faces across the seam at the back, where the angle leaps from 1 to 0, would span the whole texture.
    corners = np.where(np.ptp(corners, axis=1, keepdims=True) > 0.5, np.where(corners > 0.5, corners, 1.0), corners)
    uv = np.stack([BODY_TILE + corners, height[faces]], axis=-1)
    uv[body.scalp.faces.numpy()] = body.scalp.uv.numpy()
    return uv.astype(np.float32)
