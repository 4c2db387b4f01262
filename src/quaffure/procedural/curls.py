"""Clumps, curls and frizz on top of the axes of procedural strands."""

import math

import torch
from torch.nn.functional import normalize

from quaffure.procedural.hair_style import HairStyle
from quaffure.types import Float, Int, Tensor

# Below this length a strand has little room to wander: its frizz is in proportion [m].
FRIZZ_LENGTH = 0.1


def curl_arc_factor(controls: HairStyle) -> float:
    """Length of a curled strand over the length of its axis."""
    return math.hypot(1.0, 2 * math.pi * controls.curl_radius / controls.curl_length)


def clump_of(roots: Float[Tensor, "s 3"], spacing: float) -> Int[Tensor, " s"]:
    """For each root the root that leads its clump: leaders keep `spacing` [m], each root follows the nearest."""
    distance = torch.full((len(roots),), float("inf"))
    leaders = []
    while distance.max() > spacing:
        leaders.append(int(distance.argmax()))
        distance = torch.minimum(distance, (roots - roots[leaders[-1]]).norm(dim=-1))
    chosen = torch.tensor(leaders)
    return chosen[torch.cdist(roots, roots[chosen]).argmin(1)]


def arc_lengths(strands: Float[Tensor, "s n 3"]) -> Float[Tensor, "s n"]:
    """Length of each strand from its root to each vertex [m]."""
    return torch.nn.functional.pad(strands.diff(dim=1).norm(dim=-1).cumsum(1), (1, 0))


def clumped(controls: HairStyle, axes: Float[Tensor, "s n 3"], tied: Float[Tensor, " s"]) -> Float[Tensor, "s n 3"]:
    """Axes drawn towards the leader of their clump, the more the closer to the tip; none before `tied` [m]."""
    leader = clump_of(axes[:, 0], controls.clump_spacing)
    reach = arc_lengths(axes)
    free = (reach[:, -1:] - tied[:, None]).clamp(min=1e-6)
    share = ((reach - tied[:, None]) / free).clamp(0, 1) ** controls.clump_profile
    # Leaders across a parting or round an ear go another way: only neighbours that stay near are followed.
    gap = axes[leader] - axes
    # Hair shorter than the clumps are wide cannot reach their middle.
    share = share * (reach[:, -1:] / controls.clump_spacing).clamp(max=1).square()
    near = torch.exp(-((gap.norm(dim=-1).amax(1) / (2.5 * controls.clump_spacing)) ** 2))
    return axes + controls.clumping * (share * near[:, None])[..., None] * gap


def curled(
    controls: HairStyle,
    axes: Float[Tensor, "s n 3"],
    normals: Float[Tensor, "s 3"],
    tied: Float[Tensor, " s"],
    generator: torch.Generator,
) -> Float[Tensor, "s n 3"]:
    """Strands that wind round their axes as helices opening from `tied` [m] on, and wander a little."""
    strands, count, _ = axes.shape
    reach = (arc_lengths(axes) - tied[:, None]).clamp(min=0)
    leader = clump_of(axes[:, 0], controls.clump_spacing)
    of_clump = torch.rand(strands, 3, generator=generator)[leader]
    of_strand = torch.rand(strands, 3, generator=generator)
    varied = 1 + controls.curl_variation * (of_clump[:, 1:] + of_strand[:, 1:] - 1)
    phase = 2 * math.pi * (of_clump[:, 0] + controls.curl_phase_variation * (of_strand[:, 0] - 0.5))
    angle = phase[:, None] + 2 * math.pi * reach / (controls.curl_length * varied[:, 1:])
    opening = 1 - torch.exp(-((reach / controls.curl_start) ** 2))
    first, second = parallel_frames(axes, normals)
    wind = torch.cos(angle)[..., None] * first + torch.sin(angle)[..., None] * second
    result = axes + (controls.curl_radius * varied[:, :1] * opening)[..., None] * wind
    frizz = controls.frizz * (reach[:, -1:] / FRIZZ_LENGTH).clamp(max=1) * reach / reach[:, -1:].clamp(min=1e-6)
    return result + frizz[..., None] * _wander(strands, count, generator)


def parallel_frames(
    axes: Float[Tensor, "s n 3"], normals: Float[Tensor, "s 3"]
) -> tuple[Float[Tensor, "s n 3"], Float[Tensor, "s n 3"]]:
    """Two unit vectors across each vertex's tangent, carried along without twist from the root's normal."""
    tangents = normalize(
        torch.cat([axes[:, 1:2] - axes[:, :1], axes[:, 2:] - axes[:, :-2], axes[:, -1:] - axes[:, -2:-1]], 1), dim=-1
    )
    across, firsts = normals, []
    for tangent in tangents.unbind(1):
        across = normalize(across - (across * tangent).sum(-1, keepdim=True) * tangent, dim=-1)
        firsts.append(across)
    first = torch.stack(firsts, dim=1)
    return first, torch.linalg.cross(tangents, first)


def _wander(strands: int, count: int, generator: torch.Generator) -> Float[Tensor, "s n 3"]:
    """Two slow random waves, zero at the root."""
    share = torch.linspace(0, 1, count)
    result = torch.zeros(strands, count, 3)
    for turns in (0.7, 1.6):
        phase = 2 * math.pi * torch.rand(strands, 1, 3, generator=generator)
        wave = torch.sin(2 * math.pi * turns * share[:, None] + phase) - torch.sin(phase)
        result += 0.5 * wave
    return result
