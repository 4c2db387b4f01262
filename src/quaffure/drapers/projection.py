"""Strands pushed out of the skin after the network, which only feels a softened one.

From the root to the tip each edge whose end is in the skin, or closer to it than `CLEARANCE` of its collision margin,
is turned out along the nearest face's normal, and what hangs on it moves along: the projection of position-based
dynamics (Mueller et al. 2007) with lengths kept. Strands that touch nothing stay as they are, to the bit.
"""

from typing import no_type_check

import numpy as np
import torch
from numba import get_num_threads, njit, prange

from quaffure.body.hair_skin import HairSkin, hair_skin
from quaffure.body.head_view import posed_skin
from quaffure.body.pose_features import HEAD
from quaffure.drapers.scene import BodyBatch
from quaffure.geometry.face_grid import FaceGrid, face_grid, nearest_reached, nearest_reached_reference
from quaffure.geometry.soft_surface import FAST
from quaffure.types import Float, Positions, RestLengths, Tensor

CLEARANCE = 0.5
"""Of their collision margin, the distance at which hair is left alone. At the whole margin Eq. 10 ends, but hair is in
hair's way: what is pushed further out meets what lies there (docs/training.md has other shares)."""
SPACING = 0.0025
"""Hair is looked at about this often along its length [m]: edges of stubble are shorter."""
STEEPEST = 3.0
"""Lengths of an edge by which its end is pushed at most."""
_APART = 64  # numbers between the rooms of threads, which would write into one line of the cache


def projected(
    draped: Positions, rest_length: RestLengths, clearance: Float[Tensor, "s n"], bodies: BodyBatch
) -> Positions:
    """Strands pushed out of the skins of a batch of bodies, on any device; `draped` may be changed."""
    skin, body = hair_skin(bodies.body), bodies.body
    if draped.device.type != "cpu" or draped.dtype != torch.float32:
        vertices = bodies.posed.vertices[:, skin.vertices]
        samples = [projected_reference(*one, rest_length, clearance, skin) for one in zip(draped, vertices)]
        return torch.stack(samples)
    head = bodies.posed.joint_positions[:, body.joint_names.index(HEAD)]
    for sample, vertices in enumerate(posed_skin(body, bodies.body_pose, bodies.body_shape)):
        project(draped[sample], rest_length, clearance, skin, vertices, head[sample])
    return draped


def projected_reference(
    draped: Float[Tensor, "s n 3"],
    vertices: Float[Tensor, "v 3"],
    rest_length: RestLengths,
    clearance: Float[Tensor, "s n"],
    skin: HairSkin,
) -> Float[Tensor, "s n 3"]:
    """Torch twin of `project`, for any device.

    Returns:
        The strands out of the skin.
    """
    reach = torch.from_numpy(skin.reach).to(draped)
    corners = vertices[skin.faces]
    normals = torch.nn.functional.normalize(
        torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), dim=-1
    )
    free, out = torch.zeros_like(rest_length[:, 0]), [draped[:, 0]]
    shift = torch.zeros_like(draped[:, 0])
    for edge in range(rest_length.shape[1]):
        place, length = draped[:, edge + 1] + shift, rest_length[:, edge]
        free = free - length
        looks = (free < 0).nonzero()[:, 0]
        height, face = place.new_ones(len(place)), torch.full((len(place),), -1, device=place.device)
        height[looks], face[looks] = nearest_reached_reference(place[looks], vertices, skin.faces, reach)
        short = (clearance[:, edge + 1] - height).clamp(max=STEEPEST * length)
        pushed = (face >= 0) & (short > 0)
        free = torch.where(free < 0, SPACING - 0.5 * length, free)
        vector = place + short[:, None] * normals[face] - out[-1]
        turned = out[-1] + length[:, None] * torch.nn.functional.normalize(vector, dim=-1)
        out.append(torch.where(pushed[:, None], turned, place))
        shift = shift + out[-1] - place
    return torch.stack(out, dim=1)


def project(
    draped: Float[Tensor, "s n 3"],
    rest_length: RestLengths,
    clearance: Float[Tensor, "s n"],
    skin: HairSkin,
    vertices: Float[Tensor, "v 3"],
    centre: Float[Tensor, "3"],
) -> None:
    """Push strands out of the skin in place; float32, on the CPU.

    Args:
        draped: vertices [m].
        rest_length: of their edges [m].
        clearance: distance from the skin that each vertex is to keep [m].
        vertices: of `skin`, posed [m].
        centre: of the head [m]; hair and skin further away than a `FaceGrid` are left alone.
    """
    strands = draped.numpy()
    grid = face_grid(vertices.numpy(), skin.faces.numpy(), skin.reach, strands.reshape(-1, 3), centre.numpy())
    rows = np.empty((get_num_threads(), _APART), np.float32)
    _push_out(strands, rest_length.numpy(), clearance.numpy(), grid, rows)


@no_type_check
@njit(cache=True, parallel=True, fastmath=FAST, error_model="numpy")
def _push_out(
    strands: np.ndarray, rest_length: np.ndarray, clearance: np.ndarray, grid: FaceGrid, rows: np.ndarray
) -> None:
    threads, none = len(rows), np.float32(0.0)
    for thread in prange(threads):
        for strand in range(thread, len(strands), threads):
            own, free, dx, dy, dz = strands[strand], none, none, none, none
            for vertex in range(1, strands.shape[1]):
                x, y, z = own[vertex, 0] + dx, own[vertex, 1] + dy, own[vertex, 2] + dz
                length = rest_length[strand, vertex - 1]
                free -= length
                if free < none:
                    free = np.float32(SPACING) - np.float32(0.5) * length
                    height, face = nearest_reached(x, y, z, grid, rows[thread])
                    short = min(clearance[strand, vertex] - height, np.float32(STEEPEST) * length)
                    if face >= 0 and short > none:
                        px, py, pz = own[vertex - 1, 0], own[vertex - 1, 1], own[vertex - 1, 2]
                        record = grid.records[face]
                        ux = x + short * record[0] - px
                        uy = y + short * record[1] - py
                        uz = z + short * record[2] - pz
                        scale = length / np.sqrt(ux * ux + uy * uy + uz * uz + np.float32(1e-24))
                        ux, uy, uz = px + scale * ux, py + scale * uy, pz + scale * uz
                        dx, dy, dz = dx + ux - x, dy + uy - y, dz + uz - z
                        x, y, z = ux, uy, uz
                own[vertex, 0], own[vertex, 1], own[vertex, 2] = x, y, z
