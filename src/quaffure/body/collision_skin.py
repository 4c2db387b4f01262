"""Faces of the body that hair can get into, and the band around each in which contact is searched."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import torch

from quaffure.body.body_model import BodyModel
from quaffure.body.pose_features import HEAD, NEAR_HAIR
from quaffure.geometry.bvh import leaf_order
from quaffure.geometry.mesh import face_normals
from quaffure.geometry.signed_distance import signed_distance
from quaffure.types import Float, Int, Tensor

FURTHER = ("LowerBack", "LeftFingerBase", "RightFingerBase")
"""Joints whose skin hair can get into, besides those of the pose features."""
BELOW, ABOVE = 0.015, 0.003
"""Band of a face, below and above it [m]. An edge of long hair ends some 15 mm under the skin that it crosses; further
below, the nearest way out need not be the one by which hair came."""
THIN = (0.008, 0.004)
"""Band on both sides where the body is thin, such as fingers: of both sides the nearer counts. The first one that the
body is thick enough for, else the last [m]."""
FACE = 0.004
"""Band on both sides of face and ears, which are made of small triangles: as deep as the rest, they would cost more
than all of it, and hardly less hair would stay inside [m]."""
_ENOUGH = 0.7  # at a depth below a face, the share of it by which all other skin must be away at least


class CollisionSkin(NamedTuple):
    """Faces of a body that hair can get into: head, trunk and arms.

    Attributes:
        vertices: of the body.
        faces: indices of `vertices`, neighbours together.
        band: how far below and above each face points find it [m].
    """

    vertices: Int[Tensor, " v"]
    faces: Int[Tensor, "k 3"]
    band: Float[np.ndarray, "k 2"]


@lru_cache(maxsize=8)
def collision_skin(body: BodyModel, clearance: float = 0.0) -> CollisionSkin:
    """These faces, on the body's device; the same in all poses.

    Args:
        clearance: distance from the skin that hair is to keep at most [m]; the bands reach above it.
    """
    vertices, faces, band = _skin(body)
    above = np.maximum(band[:, 1], np.float32(clearance))
    return CollisionSkin(vertices, faces, np.stack([band[:, 0], above], axis=1))


@lru_cache(maxsize=4)
def _skin(body: BodyModel) -> CollisionSkin:
    joints = [body.joint_names.index(name) for name in (HEAD, *NEAR_HAIR, *FURTHER)]
    near = body.dense_skin_weights[:, joints].sum(1) > 0.5
    faces = body.faces[near[body.faces].any(1)]
    order = leaf_order(body.rest_vertices.cpu().numpy(), faces.cpu().numpy())
    faces = faces[torch.from_numpy(order).to(faces).long()]
    vertices, local = faces.unique(return_inverse=True)
    return CollisionSkin(vertices, local, _band(body, faces))


def _band(body: BodyModel, faces: Int[Tensor, "k 3"]) -> Float[np.ndarray, "k 2"]:
    """Bands by the thickness of the body at rest under the centre of each triangle."""
    corners = body.rest_vertices[faces]
    centre, normal = corners.mean(dim=1), face_normals(corners)
    band = torch.full((len(faces), 2), THIN[-1])
    for depth, above in ((THIN[0], THIN[0]), (BELOW, ABOVE)):
        deep = signed_distance((centre - depth * normal)[None], body.rest_surface)[0] < -_ENOUGH * depth
        band[deep.cpu()] = torch.tensor([depth, above])
    of_head = body.dense_skin_weights.argmax(1) == body.joint_names.index(HEAD)
    on_face = of_head[faces].all(1) & ~torch.isin(faces, body.faces[body.scalp.faces]).all(1)
    band[on_face.cpu()] = FACE
    return band.numpy()
