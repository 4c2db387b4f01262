"""Strands projected out of the skin after the network, which reads a point-sampled one.

From the root to the tip, every `spacing` or at every vertex, an edge whose end is in the skin, or closer to it than its
clearance, is rotated out along the nearest face's normal, and what hangs on it moves along: the projection of
position-based dynamics (Mueller et al. 2007) with lengths kept. Strands without contact stay as they are, to the bit,
and no strand depends on another.
"""

from typing import NamedTuple

import numpy as np
import torch
from numba import get_num_threads, njit, prange

from quaffure.body.collision_skin import CollisionSkin
from quaffure.geometry.mesh import face_normals
from quaffure.geometry.mls_surface import FAST
from quaffure.geometry.triangle_grid import (
    NONE,
    OUT_OF_BAND,
    TriangleGrid,
    nearest_triangle_in_band,
    nearest_triangle_in_band_reference,
    triangle_grid,
)
from quaffure.model.network_config import ProjectionConfig
from quaffure.types import Float, RestLengths, Tensor

_FARTHEST = 1e4  # of body and hair from the head [m]; beyond, a network or its input has blown up
_PADDING = 64  # numbers between the workspaces of threads, which would write into one line of the cache


def project_reference(
    deformed: Float[Tensor, "s n 3"],
    vertices: Float[Tensor, "v 3"],
    rest_length: RestLengths,
    clearance: Float[Tensor, "s n"],
    skin: CollisionSkin,
    config: ProjectionConfig,
) -> Float[Tensor, "s n 3"]:
    """Torch twin of `project`, for any device; its grid has no end."""
    band, normals = torch.from_numpy(skin.band).to(deformed), face_normals(vertices[skin.faces])
    free, out = torch.zeros_like(rest_length[:, 0]), [deformed[:, 0]]
    shift, edges = torch.zeros_like(deformed[:, 0]), rest_length.shape[1]
    for edge in range(edges):
        position, length = deformed[:, edge + 1] + shift, rest_length[:, edge]
        free = free - length
        queried = (free < 0) | (edge == edges - 1)
        height, face = position.new_ones(len(position)), torch.full((len(position),), NONE, device=position.device)
        height[queried], face[queried] = nearest_triangle_in_band_reference(
            position[queried], vertices, skin.faces, band
        )
        free = torch.where(queried, config.spacing - 0.5 * length, free)
        push = (clearance[:, edge + 1] - height).clamp(max=config.max_push * length)
        vector = position + push[:, None] * normals[face] - out[-1]
        rotated = out[-1] + length[:, None] * torch.nn.functional.normalize(vector, dim=-1)
        out.append(torch.where(((face >= 0) & (push > 0))[:, None], rotated, position))
        shift = shift + out[-1] - position
    return torch.stack(out, dim=1)


def project(
    deformed: Float[Tensor, "s n 3"],
    vertices: Float[Tensor, "v 3"],
    rest_length: RestLengths,
    clearance: Float[Tensor, "s n"],
    skin: CollisionSkin,
    centre: Float[Tensor, "3"],
    config: ProjectionConfig,
) -> Float[Tensor, "s n 3"]:
    """Strands of one groom projected out of the skin [m]; float32, on the CPU.

    Args:
        deformed: vertices [m]; where any is not finite, all stay as they are.
        vertices: of `skin`, posed [m].
        rest_length: of the strands' edges [m].
        clearance: distance from the skin that each vertex is to keep [m], not above the band of `skin`.
        centre: of the head [m]; what is outside of a `TriangleGrid` round it stays as it is.
    """
    # A comparison with NaN is false.
    if not ((vertices - centre).abs().max() < _FARTHEST and (deformed - centre).abs().max() < _FARTHEST):
        return deformed
    out, scalars = torch.empty_like(deformed), (np.float32(config.spacing), np.float32(config.max_push))
    strands = _Strands(deformed.numpy(), rest_length.numpy(), clearance.numpy(), *scalars)
    body = vertices.numpy(), skin.faces.numpy(), skin.band, centre.numpy()
    rows = np.empty((get_num_threads(), _PADDING), np.float32)
    if not _push_out(strands, triangle_grid(*body, strands.positions.reshape(-1, 3)), rows, out.numpy()):
        _push_out(strands, triangle_grid(*body), rows, out.numpy())
    return out


class _Strands(NamedTuple):
    """Arguments of `project`, and fields of `ProjectionConfig`."""

    positions: np.ndarray
    rest_length: np.ndarray
    clearance: np.ndarray
    spacing: np.float32
    max_push: np.float32


@njit(cache=True, parallel=True, fastmath=FAST, error_model="numpy")
def _push_out(strands: _Strands, grid: TriangleGrid, rows: np.ndarray, out: np.ndarray) -> bool:
    """Fill `out`; False where a push has moved hair to where the grid lists no faces."""
    threads, none, last = len(rows), np.float32(0.0), strands.positions.shape[1] - 1
    listed = np.ones(threads, np.uint8)
    for thread in prange(threads):
        for strand in range(thread, len(strands.positions), threads):
            own, result, free, dx, dy, dz = strands.positions[strand], out[strand], none, none, none, none
            result[0, 0], result[0, 1], result[0, 2] = own[0, 0], own[0, 1], own[0, 2]
            for vertex in range(1, last + 1):
                x, y, z = own[vertex, 0] + dx, own[vertex, 1] + dy, own[vertex, 2] + dz
                length = strands.rest_length[strand, vertex - 1]
                free -= length
                if free < none or vertex == last:
                    free = strands.spacing - np.float32(0.5) * length
                    height, face = nearest_triangle_in_band(x, y, z, grid, rows[thread])
                    if face == OUT_OF_BAND:
                        listed[thread] = 0
                    push = min(strands.clearance[strand, vertex] - height, strands.max_push * length)
                    if face >= 0 and push > none:
                        px, py, pz = result[vertex - 1, 0], result[vertex - 1, 1], result[vertex - 1, 2]
                        record = grid.records[face]
                        ux = x + push * record[0] - px
                        uy = y + push * record[1] - py
                        uz = z + push * record[2] - pz
                        scale = length / np.sqrt(ux * ux + uy * uy + uz * uz + np.float32(1e-24))
                        ux, uy, uz = px + scale * ux, py + scale * uy, pz + scale * uz
                        dx, dy, dz = dx + ux - x, dy + uy - y, dz + uz - z
                        x, y, z = ux, uy, uz
                result[vertex, 0], result[vertex, 1], result[vertex, 2] = x, y, z
    return listed.min() == 1
