"""The skin that hair is kept out of."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import torch

from quaffure.body.body_model import BodyModel
from quaffure.body.pose_features import HEAD, NEAR_HAIR
from quaffure.geometry.face_tree import build_face_tree
from quaffure.types import Float, Int, Tensor

FURTHER = ("LowerBack", "LeftFingerBase", "RightFingerBase")
"""Joints whose skin hair can get into, besides those that the network is told of."""
BELOW, ABOVE = 0.015, 0.003
"""How far below and above the skin hair is told of it [m]. Further below, where it has crossed the body, the nearest
way out need not be the one by which it came."""
EARS, HANDS = 0.004, 0.008
"""The same, below and above alike, where the body is thin: of both sides the nearer counts [m]."""


class HairSkin(NamedTuple):
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
def hair_skin(body: BodyModel) -> HairSkin:
    """Which skin it is, on the body's device; the same in all poses."""
    weights, names = body.dense_skin_weights, body.joint_names
    near = weights[:, [names.index(name) for name in (HEAD, *NEAR_HAIR, *FURTHER)]].sum(1) > 0.5
    faces = body.faces[near[body.faces].any(1)]
    order = build_face_tree(body.rest_vertices.cpu().numpy(), faces.cpu().numpy()).face_order
    faces = faces[torch.from_numpy(order).to(faces).long()]
    led_by, on_scalp = weights.argmax(1), torch.zeros_like(near)
    on_scalp[body.faces[body.scalp.faces].flatten()] = True
    hands = torch.tensor([names.index(name) for name in names if "Hand" in name or "Finger" in name]).to(faces)
    on_hands = torch.isin(led_by, hands)[faces].any(1)
    on_face = (led_by == names.index(HEAD))[faces].all(1) & ~on_scalp[faces].all(1)
    reach = torch.tensor([BELOW, ABOVE]).repeat(len(faces), 1)
    reach[on_face.cpu()], reach[on_hands.cpu()] = EARS, HANDS
    vertices, local = faces.unique(return_inverse=True)
    return HairSkin(vertices, local, reach.numpy())
