"""What binds a groom to a body in other programs: both at rest, and texture coordinates that they share."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float

from quaffure.body.body_model import BodyModel
from quaffure.hair.groom import Groom
from quaffure.hair.posing import posed_strands
from quaffure.types import Tensor

BODY_TILE = 1.0
"""First u of the tile (UDIM 1002) of the skin off the scalp, whose own chart fills the tile from 0 to 1 (1001)."""


@dataclass(frozen=True)
class GroomBinding:
    """A groom and a shaped body in the rest pose.

    Attributes:
        strands: guides at rest [m, world].
        body_vertices: [m, world].
        root_uv: position of every root on the scalp chart.
        body_uv: texture coordinates of every corner of the body's faces: the scalp chart on the scalp, where they agree
            with `root_uv`, and a cylinder around the body in the next tile elsewhere.
    """

    strands: Float[np.ndarray, "s n 3"]
    body_vertices: Float[np.ndarray, "v 3"]
    root_uv: Float[np.ndarray, "s 2"]
    body_uv: Float[np.ndarray, "k 3 2"]


def groom_binding(groom: Groom, body: BodyModel, body_shape: Float[Tensor, "10"]) -> GroomBinding:
    """The groom on the body of a shape, in the rest pose.

    Args:
        groom: registered to `body`.
    """
    rest = body.pose(torch.zeros(1, 3 * len(body.joint_names)), body_shape[None].to(body.rest_vertices))
    return GroomBinding(
        strands=posed_strands(groom, rest, body)[0].numpy(),
        body_vertices=rest.vertices[0].numpy(),
        root_uv=groom.root_uv.numpy(),
        body_uv=body_uv(body),
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
