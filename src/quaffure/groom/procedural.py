"""Procedural grooms: strands grown from the scalp along a styled direction field, on the mean body at rest."""

import math

import numpy as np
import torch

from quaffure.body.body_model import BodyModel
from quaffure.config import TEXTURE_SIZE, VERTICES_PER_STRAND
from quaffure.errors import InputError
from quaffure.geometry.mesh import angle_weighted_vertex_normals
from quaffure.geometry.surface import Surface
from quaffure.groom.clearance import CLEARANCE, pushed_out, rest_surface
from quaffure.groom.curls import clumped, curl_arc_factor, curled
from quaffure.groom.groom import Groom
from quaffure.groom.growth import grow
from quaffure.groom.hair_style import STYLES, HairStyle
from quaffure.groom.resample import resample_by_arc_length
from quaffure.groom.scalp_texture import select_guides
from quaffure.groom.strands import Strands
from quaffure.types import Float, Int, Tensor

LICENCE = "Apache-2.0 (procedural, part of quaffure)"
# Steps of the growth for each edge of the groom.
STEPS_PER_EDGE = 2
# Roots stay this share of a cell clear of its border.
JITTER = 0.35


def make_groom(style: str | HairStyle, body: BodyModel, seed: int = 0, surface: Surface | None = None) -> Groom:
    """A groom in a style: the same for the same style, body and seed, on any machine of one kind.

    Args:
        style: a name in `STYLES`, or controls.
        surface: of the body at rest, when at hand (`rest_surface`).

    Raises:
        InputError: no style of that name.
    """
    name, controls = _controls(style)
    surface = surface or rest_surface(body)
    generator = torch.Generator().manual_seed(seed)
    faces, barycentric = spread_roots(body, controls.root_rows, generator)
    roots = (barycentric[..., None] * body.rest_vertices[body.faces[faces]]).sum(-2)
    normals = scalp_normals(body, faces, barycentric)
    uv = body.scalp.uv_at(faces, barycentric)
    lengths = strand_lengths(controls, uv, generator)
    steps = STEPS_PER_EDGE * (VERTICES_PER_STRAND - 1)
    axes = grow(controls, roots, normals, lengths / curl_arc_factor(controls) / steps, steps, body, surface, generator)
    axes = cut_below(axes, controls.cut_height, body)
    axes = clumped(controls, axes)
    strands = pushed_out(_evenly(curled(controls, axes, normals, generator)), surface, CLEARANCE)
    strands[:, 0] = roots
    # Rounding can move a root across a texel's border, to where another one is.
    return select_guides(Groom(name, strands, faces, barycentric, uv, LICENCE))


def _controls(style: str | HairStyle) -> tuple[str, HairStyle]:
    if isinstance(style, HairStyle):
        return "procedural", style
    if style not in STYLES:
        raise InputError("style", f"one of {', '.join(sorted(STYLES))}", repr(style))
    return style, STYLES[style]


def spread_roots(
    body: BodyModel, rows: int, generator: torch.Generator
) -> tuple[Int[Tensor, " s"], Float[Tensor, "s 3"]]:
    """Roots on a jittered grid of `rows` x `rows` over the scalp chart: body faces and barycentric coordinates.

    No two fall into one texel of the texture, as long as `rows` is at most its size.
    """
    centre = (torch.arange(rows) + 0.5) / rows
    v, u = torch.meshgrid(centre, centre, indexing="ij")
    even = torch.stack([u, v], dim=-1).reshape(-1, 2)
    even = even[body.scalp.locate(even)[0] >= 0]
    uv = even + JITTER / rows * (2 * torch.rand(even.shape, generator=generator) - 1)
    # Where the jitter leaves the scalp or crowds a texel, it is taken back.
    for _ in range(len(even)):
        row, column = body.scalp.texels(uv, TEXTURE_SIZE).unbind(-1)
        texel, visits = torch.unique(row * TEXTURE_SIZE + column, return_inverse=True)
        crowded = torch.bincount(visits, minlength=len(texel))[visits] > 1
        bad = ((body.scalp.locate(uv)[0] < 0) | crowded) & (uv != even).any(-1)
        if not bad.any():
            break
        uv = torch.where(bad[:, None], even, uv)
    return body.scalp.locate(uv)


def _evenly(fine: Float[Tensor, "s n 3"]) -> Float[Tensor, "s m 3"]:
    strands, count, _ = fine.shape
    ragged = Strands(fine.reshape(-1, 3).numpy(), np.full(strands, count), "procedural strands")
    return torch.from_numpy(resample_by_arc_length(ragged, VERTICES_PER_STRAND))


def scalp_normals(body: BodyModel, faces: Int[Tensor, " s"], barycentric: Float[Tensor, "s 3"]) -> Float[Tensor, "s 3"]:
    """Smooth unit normals of the scalp on its own: the ears beside it do not bend them."""
    own = angle_weighted_vertex_normals(body.rest_vertices[None], body.faces[body.scalp.faces])[0]
    blended = (barycentric[..., None] * torch.nn.functional.normalize(own, dim=-1)[body.faces[faces]]).sum(-2)
    return torch.nn.functional.normalize(blended, dim=-1)


def strand_lengths(controls: HairStyle, uv: Float[Tensor, "s 2"], generator: torch.Generator) -> Float[Tensor, " s"]:
    """Length of each strand [m]: the length map over the chart (forehead, crown, sides, nape) and its variation."""
    aside = (2 * uv[:, 0] - 1).abs().square()
    ahead = torch.cos(0.5 * math.pi * uv[:, 1].clamp(0, 1)).square()
    front, crown, side, nape = controls.length_map
    middle = 4 * uv[:, 1] * (1 - uv[:, 1])
    ends = front * ahead + nape * (1 - ahead)
    factor = side * aside + (1 - aside) * (crown * middle + ends * (1 - middle))
    noise = controls.length_variation * (2 * torch.rand(len(uv), generator=generator) - 1)
    return controls.length * factor * (1 + noise)


def cut_below(axes: Float[Tensor, "s n 3"], height: float | None, body: BodyModel) -> Float[Tensor, "s n 3"]:
    """Strands cut where they first pass below `height` [m over the Head joint] and brought back to as many vertices."""
    if height is None:
        return axes
    level = height + float(body.rest_joints[body.joint_names.index("Head"), 2])
    count = axes.shape[1]
    below = axes[..., 2] < level
    first = torch.where(below.any(1), below.float().argmax(1), torch.full((len(axes),), count - 1)).clamp(
        min=count // 6
    )
    place = torch.linspace(0, 1, count) * first[:, None]
    left = place.long().clamp(max=count - 2)
    weight = (place - left)[..., None]
    index = left[..., None].expand(-1, -1, 3)
    return (1 - weight) * axes.gather(1, index) + weight * axes.gather(1, index + 1)
