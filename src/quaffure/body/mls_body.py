"""The body as the network looks at it: a few hundred oriented points of the skin that hair can touch."""

from functools import lru_cache

import torch
from torch.nn.functional import normalize

from quaffure.body.body_model import BodyModel, PosedBody
from quaffure.body.pose_features import HEAD, NEAR_HAIR
from quaffure.geometry.mesh import angle_weighted_vertex_normals
from quaffure.geometry.mls_surface import LEAF, MlsSurface
from quaffure.geometry.sampling import neighbours_together, spread_subset
from quaffure.types import Float, Int, Tensor

LEAVES = 128
"""Leaves of points; with 1,024 points they are 3.5 cm from each other."""
KERNEL_RADIUS = 0.07
"""Reach of a point [m]."""


def mls_body(body: BodyModel, posed: PosedBody) -> MlsSurface:
    """Head, trunk and arms of posed bodies, softened."""
    vertices, normals, weights = skin_points(body)
    rotations = (weights @ posed.joint_rotations.flatten(2)).unflatten(-1, (3, 3))
    turned = normalize((rotations @ normals[..., None])[..., 0], dim=-1)
    points = posed.vertices[:, vertices]
    return MlsSurface(points.unflatten(1, (LEAVES, LEAF)), turned.unflatten(1, (LEAVES, LEAF)), KERNEL_RADIUS)


@lru_cache(maxsize=4)
def skin_points(body: BodyModel) -> tuple[Int[Tensor, " k"], Float[Tensor, "k 3"], Float[Tensor, "k 27"]]:
    """Vertices spread evenly over the skin, leaf after leaf, their normals at rest and their skin weights."""
    near = torch.tensor([body.joint_names.index(name) for name in (HEAD, *NEAR_HAIR)], device=body.faces.device)
    weights = body.dense_skin_weights
    reachable = (weights[:, near].sum(1) > 0.5).nonzero()[:, 0]
    spread = spread_subset(body.rest_vertices[reachable].cpu().numpy(), LEAVES * LEAF)
    vertices = reachable[torch.from_numpy(spread).to(reachable.device)]
    vertices = vertices[neighbours_together(body.rest_vertices[vertices], LEAF)]
    normals = angle_weighted_vertex_normals(body.rest_vertices[None], body.faces)[0, vertices]
    return vertices, normalize(normals, dim=-1), weights[vertices]
