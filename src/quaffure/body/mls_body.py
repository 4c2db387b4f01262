"""The body as a point-sampled implicit surface: about a thousand oriented points of the skin that hair can touch."""

from dataclasses import dataclass
from functools import lru_cache

import torch
from torch.nn.functional import normalize

from quaffure.body.body_model import BodyModel, PosedBody
from quaffure.body.pose_features import HEAD, NEAR_HAIR
from quaffure.geometry.mesh import angle_weighted_vertex_normals
from quaffure.geometry.mls_kernels import LEAF
from quaffure.geometry.mls_surface import MlsSurface
from quaffure.geometry.sampling import farthest_points, spatial_order
from quaffure.types import Float, Int, Tensor


@dataclass(frozen=True)
class MlsBodyConfig:
    """How a body is sampled."""

    leaves: int = 128
    """Leaves of eight points each; 128 leaves are points 3.5 cm apart."""
    kernel_radius: float = 0.07
    """Support of a point's weight [m]."""

    def __post_init__(self) -> None:
        if not (isinstance(self.leaves, int) and 1 <= self.leaves <= 1024 and 0 < self.kernel_radius < 10):
            raise ValueError(f"expected 1 to 1024 leaves and a kernel radius up to 10 m, found {self}")


def mls_body(body: BodyModel, posed: PosedBody, config: MlsBodyConfig) -> MlsSurface:
    """Head, trunk and arms of posed bodies."""
    vertices, normals, weights = skin_points(body, config.leaves)
    rotations = (weights @ posed.joint_rotations.flatten(2)).unflatten(-1, (3, 3))
    rotated = normalize((rotations @ normals[..., None])[..., 0], dim=-1)
    points = posed.vertices[:, vertices]
    return MlsSurface(points.unflatten(1, (-1, LEAF)), rotated.unflatten(1, (-1, LEAF)), config.kernel_radius)


@lru_cache(maxsize=4)
def skin_points(body: BodyModel, leaves: int) -> tuple[Int[Tensor, " k"], Float[Tensor, "k 3"], Float[Tensor, "k 27"]]:
    """Vertices spread evenly over the skin, leaf after leaf, their normals at rest and their skin weights."""
    near = torch.tensor([body.joint_names.index(name) for name in (HEAD, *NEAR_HAIR)], device=body.faces.device)
    weights = body.dense_skin_weights
    reachable = (weights[:, near].sum(1) > 0.5).nonzero()[:, 0]
    spread = farthest_points(body.rest_vertices[reachable].cpu().numpy(), leaves * LEAF)
    vertices = reachable[torch.from_numpy(spread).to(reachable.device)]
    vertices = vertices[spatial_order(body.rest_vertices[vertices], LEAF)]
    normals = angle_weighted_vertex_normals(body.rest_vertices[None], body.faces)[0, vertices]
    return vertices, normalize(normals, dim=-1), weights[vertices]
