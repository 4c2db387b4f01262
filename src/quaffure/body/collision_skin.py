"""The skin that hair is kept out of."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import torch

from quaffure.body.body_model import BodyModel
from quaffure.body.pose_features import HEAD, NEAR_HAIR
from quaffure.geometry.bvh import leaf_order
from quaffure.geometry.mesh import face_normals
from quaffure.geometry.signed_distance import signed_distance
from quaffure.geometry.surface import posed_surface
from quaffure.types import Float, Int, Tensor

FURTHER = ("LowerBack", "LeftFingerBase", "RightFingerBase")
"""Joints whose skin hair can get into, besides those that the network is told of."""
BELOW, ABOVE = 0.015, 0.003
"""How far below and above the skin hair is told of it [m]. An edge of long hair ends some 15 mm under the skin that it
crosses; further below, the nearest way out need not be the one by which hair came."""
THIN = (0.008, 0.004)
"""The same, below and above alike, where the body is thin, such as fingers: of both sides the nearer counts. The first
of which there is flesh enough, else the last [m]."""
FACE = 0.004
"""The same for face and ears, which are made of small triangles: as deep as the rest, they would cost more than all of
it, and hardly less hair would stay inside [m]."""
_ENOUGH = 0.7  # at a depth below a face, the share of it by which all other skin must be away at least


class CollisionSkin(NamedTuple):
    """Faces of a body that hair can get into: head, trunk and arms.

    Attributes:
        vertices: of the body.
        faces: indices of `vertices`, neighbours together.
        reach: how far below and above each face hair is told of it [m].
    """

    vertices: Int[Tensor, " v"]
    faces: Int[Tensor, "k 3"]
    reach: Float[np.ndarray, "k 2"]


@lru_cache(maxsize=4)
def collision_skin(body: BodyModel) -> CollisionSkin:
    """Which skin it is, on the body's device; the same in all poses."""
    joints = [body.joint_names.index(name) for name in (HEAD, *NEAR_HAIR, *FURTHER)]
    near = body.dense_skin_weights[:, joints].sum(1) > 0.5
    faces = body.faces[near[body.faces].any(1)]
    order = leaf_order(body.rest_vertices.cpu().numpy(), faces.cpu().numpy())
    faces = faces[torch.from_numpy(order).to(faces).long()]
    vertices, local = faces.unique(return_inverse=True)
    return CollisionSkin(vertices, local, _reach(body, faces))


def _reach(body: BodyModel, faces: Int[Tensor, "k 3"]) -> Float[np.ndarray, "k 2"]:
    """By how deep the body at rest is under the middle of each triangle."""
    corners = body.rest_vertices[faces]
    middle, normal = corners.mean(dim=1), face_normals(corners)
    surface = posed_surface(body.surface_topology, body.rest_vertices[None])
    reach = torch.full((len(faces), 2), THIN[-1])
    for depth, above in ((THIN[0], THIN[0]), (BELOW, ABOVE)):
        deep = signed_distance((middle - depth * normal)[None], surface)[0] < -_ENOUGH * depth
        reach[deep.cpu()] = torch.tensor([depth, above])
    of_head = body.dense_skin_weights.argmax(1) == body.joint_names.index(HEAD)
    on_face = of_head[faces].all(1) & ~torch.isin(faces, body.faces[body.scalp.faces]).all(1)
    reach[on_face.cpu()] = FACE
    return reach.numpy()
