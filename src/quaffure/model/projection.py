"""Strands pushed out of the skin after the network, which only feels a softened one.

From the root to the tip, every `SPACING` or at every vertex, an edge whose end is in the skin, or closer to it than
`CLEARANCE` of its collision margin, is turned out along the nearest face's normal, and what hangs on it moves along:
the projection of position-based dynamics (Mueller et al. 2007) with lengths kept. Strands that touch nothing stay as
they are, to the bit, and no strand depends on another.
"""

from typing import no_type_check

import numpy as np
import torch
from numba import get_num_threads, njit, prange

from quaffure.body.collision_skin import ABOVE, CollisionSkin, collision_skin
from quaffure.body.head_frame import posed_skin
from quaffure.energies.rest_state import RestState
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
from quaffure.scene import BodyBatch
from quaffure.types import Float, Positions, RestLengths, Tensor

CLEARANCE = 0.5
"""Of their collision margin, the distance at which hair is left alone. At the whole margin Eq. 10 ends, but hair is in
hair's way: what is pushed further out meets what lies there (docs/training.md has other shares)."""
SPACING = 0.0025
"""Hair is looked at about this often along its length [m]: edges of stubble are shorter."""
STEEPEST = 3.0
"""Lengths of an edge by which its end is pushed at most: it then stands nearly along the push."""
_FARTHEST = 1e4  # of body and hair from the head [m]; beyond, a network or its input has blown up
_APART = 64  # numbers between the rooms of threads, which would write into one line of the cache


def clearance_of(rest: RestState) -> Float[Tensor, "s n"]:
    """Distance from the skin that each vertex is to keep [m]."""
    return (CLEARANCE * rest.collision_margin).clamp(max=ABOVE)


def projected(
    deformed: Positions, rest_length: RestLengths, clearance: Float[Tensor, "s n"], bodies: BodyBatch
) -> Positions:
    """Strands [m] pushed out of the skins of a batch of bodies, on any device; non-finite ones as they are."""
    skin = collision_skin(bodies.body)
    if deformed.device.type != "cpu" or deformed.dtype != torch.float32:
        posed = bodies.posed.vertices[:, skin.vertices]
        return torch.stack(
            [projected_reference(*sample, rest_length, clearance, skin) for sample in zip(deformed, posed)]
        )
    out, (vertices, heads) = torch.empty_like(deformed), posed_skin(bodies.body, bodies.body_pose, bodies.body_shape)
    for sample in range(len(deformed)):
        project(deformed[sample], vertices[sample], rest_length, clearance, skin, heads[sample], out[sample])
    return out


def projected_reference(
    deformed: Float[Tensor, "s n 3"],
    vertices: Float[Tensor, "v 3"],
    rest_length: RestLengths,
    clearance: Float[Tensor, "s n"],
    skin: CollisionSkin,
) -> Float[Tensor, "s n 3"]:
    """Torch twin of `project`, for any device; knows no end of the grid."""
    reach, normals = torch.from_numpy(skin.reach).to(deformed), face_normals(vertices[skin.faces])
    free, out = torch.zeros_like(rest_length[:, 0]), [deformed[:, 0]]
    shift, edges = torch.zeros_like(deformed[:, 0]), rest_length.shape[1]
    for edge in range(edges):
        place, length = deformed[:, edge + 1] + shift, rest_length[:, edge]
        free = free - length
        looked = (free < 0) | (edge == edges - 1)
        height, face = place.new_ones(len(place)), torch.full((len(place),), NONE, device=place.device)
        height[looked], face[looked] = nearest_triangle_in_band_reference(place[looked], vertices, skin.faces, reach)
        free = torch.where(looked, SPACING - 0.5 * length, free)
        short = (clearance[:, edge + 1] - height).clamp(max=STEEPEST * length)
        vector = place + short[:, None] * normals[face] - out[-1]
        turned = out[-1] + length[:, None] * torch.nn.functional.normalize(vector, dim=-1)
        out.append(torch.where(((face >= 0) & (short > 0))[:, None], turned, place))
        shift = shift + out[-1] - place
    return torch.stack(out, dim=1)


def project(
    deformed: Float[Tensor, "s n 3"],
    vertices: Float[Tensor, "v 3"],
    rest_length: RestLengths,
    clearance: Float[Tensor, "s n"],
    skin: CollisionSkin,
    centre: Float[Tensor, "3"],
    out: Float[Tensor, "s n 3"],
) -> None:
    """Push the strands of one groom out of the skin; float32, on the CPU.

    Args:
        deformed: vertices [m]; where any is not finite, all stay as they are.
        vertices: of `skin`, posed [m].
        rest_length: of the strands' edges [m].
        clearance: see `clearance_of`.
        centre: of the head [m]; what is outside of a `TriangleGrid` round it stays as it is.
        out: filled [m].
    """
    # A comparison with NaN is false.
    if not ((vertices - centre).abs().max() < _FARTHEST and (deformed - centre).abs().max() < _FARTHEST):
        out.copy_(deformed)
        return
    body = vertices.numpy(), skin.faces.numpy(), skin.reach, centre.numpy()
    strands = deformed.numpy(), rest_length.numpy(), clearance.numpy()
    rows = np.empty((get_num_threads(), _APART), np.float32)
    if not _push_out(*strands, triangle_grid(*body, strands[0].reshape(-1, 3)), rows, out.numpy()):
        _push_out(*strands, triangle_grid(*body), rows, out.numpy())


@no_type_check
@njit(cache=True, parallel=True, fastmath=FAST, error_model="numpy")
def _push_out(
    strands: np.ndarray, rest_length: np.ndarray, clearance: np.ndarray, grid: TriangleGrid, rows: np.ndarray,
    out: np.ndarray,
) -> bool:  # fmt: skip
    """Fill `out`; False where a push has moved hair to where the grid lists no faces."""
    threads, none, last = len(rows), np.float32(0.0), strands.shape[1] - 1
    listed = np.ones(threads, np.uint8)
    for thread in prange(threads):
        for strand in range(thread, len(strands), threads):
            own, result, free, dx, dy, dz = strands[strand], out[strand], none, none, none, none
            result[0, 0], result[0, 1], result[0, 2] = own[0, 0], own[0, 1], own[0, 2]
            for vertex in range(1, last + 1):
                x, y, z = own[vertex, 0] + dx, own[vertex, 1] + dy, own[vertex, 2] + dz
                length = rest_length[strand, vertex - 1]
                free -= length
                if free < none or vertex == last:
                    free = np.float32(SPACING) - np.float32(0.5) * length
                    height, face = nearest_triangle_in_band(x, y, z, grid, rows[thread])
                    if face == OUT_OF_BAND:
                        listed[thread] = 0
                    short = min(clearance[strand, vertex] - height, np.float32(STEEPEST) * length)
                    if face >= 0 and short > none:
                        px, py, pz = result[vertex - 1, 0], result[vertex - 1, 1], result[vertex - 1, 2]
                        record = grid.records[face]
                        ux = x + short * record[0] - px
                        uy = y + short * record[1] - py
                        uz = z + short * record[2] - pz
                        scale = length / np.sqrt(ux * ux + uy * uy + uz * uz + np.float32(1e-24))
                        ux, uy, uz = px + scale * ux, py + scale * uy, pz + scale * uz
                        dx, dy, dz = dx + ux - x, dy + uy - y, dz + uz - z
                        x, y, z = ux, uy, uz
                result[vertex, 0], result[vertex, 1], result[vertex, 2] = x, y, z
    return listed.min() == 1
