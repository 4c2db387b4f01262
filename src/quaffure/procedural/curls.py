"""Clumps, curls and frizz on top of the axes of procedural strands."""

import math

import numpy as np
import torch
from torch.nn.functional import normalize

from quaffure.geometry.polyline import arc_lengths
from quaffure.procedural.hair_style import HairStyle
from quaffure.types import Float, Int, Tensor

# Below this length the frizz of a strand is in proportion to its length [m].
FRIZZ_LENGTH = 0.1


def curl_arc_factor(controls: HairStyle) -> float:
    """Length of a curled strand over the length of its axis."""
    return math.hypot(1.0, 2 * math.pi * controls.curl_radius / controls.curl_length)


def clump_centres(roots: Float[Tensor, "s 3"], spacing: float) -> Int[Tensor, " s"]:
    """For each root the nearest root in a subset with distances above `spacing` [m] (farthest point sampling)."""
    distance = torch.full((len(roots),), float("inf"))
    centres = []
    while distance.max() > spacing:
        centres.append(int(distance.argmax()))
        distance = torch.minimum(distance, (roots - roots[centres[-1]]).norm(dim=-1))
    chosen = torch.tensor(centres)
    # Not by a matrix product, whose last bits depend on the number of threads.
    distances = torch.cdist(roots, roots[chosen], compute_mode="donot_use_mm_for_euclid_dist")
    return chosen[distances.argmin(1)]


def clumped(controls: HairStyle, axes: Float[Tensor, "s n 3"], tied: Float[Tensor, " s"]) -> Float[Tensor, "s n 3"]:
    """Axes attracted to the centre of their clump, most at the tip, not at all before the length `tied` [m]."""
    centre = clump_centres(axes[:, 0], controls.clump_spacing)
    length = arc_lengths(axes)
    free = (length[:, -1:] - tied[:, None]).clamp(min=1e-6)
    share = _power(((length - tied[:, None]) / free).clamp(0, 1), controls.clump_profile)
    # A centre on the other side of a parting or an ear diverges: only one that stays near attracts.
    gap = axes[centre] - axes
    # Hair shorter than the width of a clump cannot reach its centre.
    share = share * (length[:, -1:] / controls.clump_spacing).clamp(max=1).square()
    near = torch.exp(-((gap.norm(dim=-1).amax(1) / (2.5 * controls.clump_spacing)) ** 2))
    return axes + controls.clumping * (share * near[:, None])[..., None] * gap


def curled(
    controls: HairStyle,
    axes: Float[Tensor, "s n 3"],
    normals: Float[Tensor, "s 3"],
    tied: Float[Tensor, " s"],
    generator: torch.Generator,
) -> Float[Tensor, "s n 3"]:
    """Helices about the axes, of increasing radius from the length `tied` [m] on, with frizz."""
    strands, count, _ = axes.shape
    length = (arc_lengths(axes) - tied[:, None]).clamp(min=0)
    centre = clump_centres(axes[:, 0], controls.clump_spacing)
    of_clump = torch.rand(strands, 3, generator=generator)[centre]
    of_strand = torch.rand(strands, 3, generator=generator)
    varied = 1 + controls.curl_variation * (of_clump[:, 1:] + of_strand[:, 1:] - 1)
    phase = 2 * math.pi * (of_clump[:, 0] + controls.curl_phase_variation * (of_strand[:, 0] - 0.5))
    angle = phase[:, None] + 2 * math.pi * length / (controls.curl_length * varied[:, 1:])
    opening = 1 - torch.exp(-((length / controls.curl_start) ** 2))
    first, second = parallel_frames(axes, normals)
    radial = torch.cos(angle)[..., None] * first + torch.sin(angle)[..., None] * second
    result = axes + (controls.curl_radius * varied[:, :1] * opening)[..., None] * radial
    frizz = controls.frizz * (length[:, -1:] / FRIZZ_LENGTH).clamp(max=1) * length / length[:, -1:].clamp(min=1e-6)
    return result + frizz[..., None] * _random_waves(strands, count, generator)


def _power(base: Float[Tensor, "s n"], exponent: float) -> Float[Tensor, "s n"]:
    """A power, by numpy: the last bits of torch's depend on where each thread begins."""
    return torch.from_numpy(np.power(base.numpy(), np.float32(exponent)))


def parallel_frames(
    axes: Float[Tensor, "s n 3"], normals: Float[Tensor, "s 3"]
) -> tuple[Float[Tensor, "s n 3"], Float[Tensor, "s n 3"]]:
    """Two unit vectors perpendicular to each vertex's tangent, parallel-transported from the root's normal."""
    tangents = normalize(
        torch.cat([axes[:, 1:2] - axes[:, :1], axes[:, 2:] - axes[:, :-2], axes[:, -1:] - axes[:, -2:-1]], 1), dim=-1
    )
    across, firsts = normals, []
    for tangent in tangents.unbind(1):
        across = normalize(across - (across * tangent).sum(-1, keepdim=True) * tangent, dim=-1)
        firsts.append(across)
    first = torch.stack(firsts, dim=1)
    return first, torch.linalg.cross(tangents, first)


def _random_waves(strands: int, count: int, generator: torch.Generator) -> Float[Tensor, "s n 3"]:
    """Two slow random waves, zero at the root."""
    share = torch.linspace(0, 1, count)
    result = torch.zeros(strands, count, 3)
    for periods in (0.7, 1.6):
        phase = 2 * math.pi * torch.rand(strands, 1, 3, generator=generator)
        result += 0.5 * (torch.sin(2 * math.pi * periods * share[:, None] + phase) - torch.sin(phase))
    return result
