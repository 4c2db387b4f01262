"""Small synthetic scenes that many tests share."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch
from scipy.spatial import ConvexHull

from quaffure.body import BodyModel, bundled_clip
from quaffure.geometry import Surface, directors, posed_surface, surface_topology
from quaffure.hair import Groom, RegistrationReport
from quaffure.procedural import make_groom
from quaffure.scene import BodyBatch, PosedScene, Scene

Registered = Callable[..., tuple[Groom, RegistrationReport]]
"""The fixture `registered`."""
HELD_EDGES = 12
"""Of `half_held_groom`, from the root."""


def sphere_mesh(radius: float = 0.1, count: int = 400) -> tuple[torch.Tensor, torch.Tensor]:
    """Vertices [v 3] and outward faces [k 3] of a closed sphere round the origin."""
    index = np.arange(count) + 0.5
    polar, azimuth = np.arccos(1 - 2 * index / count), math.pi * (1 + math.sqrt(5)) * index
    points = np.stack([np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)], axis=1)
    faces = ConvexHull(points).simplices.astype(np.int64)
    corners = points[faces]
    flipped = (
        np.einsum("ki,ki->k", np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), corners[:, 0]) < 0
    )
    faces[flipped] = faces[flipped][:, ::-1]
    return torch.tensor(radius * points, dtype=torch.float32), torch.from_numpy(faces)


def sphere_surface(batch: int = 1, radius: float = 0.1, dtype: torch.dtype = torch.float32) -> Surface:
    vertices, faces = sphere_mesh(radius)
    return posed_surface(surface_topology(vertices, faces), vertices.to(dtype).expand(batch, -1, -1))


def strands_round_sphere(strands: int = 40, vertices: int = 24, length: float = 0.2, seed: int = 0) -> torch.Tensor:
    """Wavy strands [s n 3] that leave a sphere of radius 0.1 m in all directions, root on its surface."""
    generator = torch.Generator().manual_seed(seed)
    outward = torch.nn.functional.normalize(torch.randn(strands, 3, generator=generator), dim=-1)
    along = torch.linspace(0, 1, vertices)
    wave = 0.01 * torch.sin(7 * along)[:, None] * torch.randn(strands, 1, 3, generator=generator)
    return outward[:, None] * (0.1 + length * along[:, None]) + wave * along[:, None]


def sphere_groom(**options: int | float) -> Groom:
    rest = strands_round_sphere(**options)  # type: ignore[arg-type]
    count = len(rest)
    return Groom(
        name="round_sphere",
        rest_strands=rest,
        root_faces=torch.zeros(count, dtype=torch.long),
        root_barycentric=torch.full((count, 3), 1 / 3),
        root_uv=torch.rand(count, 2, generator=torch.Generator().manual_seed(1)),
    )


def half_held_groom() -> Groom:
    """Strands round a sphere, every second of which is held over its first `HELD_EDGES`."""
    groom = sphere_groom(strands=20)
    weight = torch.zeros_like(groom.rest_lengths)
    weight[::2, :HELD_EDGES] = 1e-3
    return replace(groom, goal_weight=weight)


def few_strands(body: BodyModel, style: str = "long_straight", count: int = 60) -> Groom:
    """About `count` strands of a bundled style, evenly spread over its list."""
    groom = make_groom(style, body)
    return groom.select(torch.arange(0, len(groom), len(groom) // count))


def upright_scene(groom: Groom, body: BodyModel) -> Scene:
    """On the mean body in its rest pose."""
    return Scene(groom, BodyBatch(body, torch.zeros(1, 81), torch.zeros(1, 10)))


def clip_scene(groom: Groom, body: BodyModel, clip: str, frames: slice) -> Scene:
    """On the mean body in some frames of a bundled clip."""
    body_pose = bundled_clip(clip, body).body_pose[frames]
    return Scene(groom, BodyBatch(body, body_pose, torch.zeros(len(body_pose), 10)))


def random_bodies(body: BodyModel, count: int) -> BodyBatch:
    """Bodies of random shapes, every joint of which is rotated a little."""
    generator = torch.Generator().manual_seed(0)
    pose = 0.15 * torch.randn(count, 81, generator=generator)
    return BodyBatch(body, pose, torch.randn(count, 10, generator=generator))


def posed_scene(groom: Groom, posed: torch.Tensor | None = None, surface: Surface | None = None) -> PosedScene:
    """A groom, at rest or posed [b s n 3], on a sphere of radius 0.1 m or on another surface."""
    posed = groom.rest_strands[None] if posed is None else posed
    return PosedScene(groom, posed, surface or sphere_surface(len(posed), dtype=posed.dtype))


def surface_on(device: str, surface: Surface) -> Surface:
    """The same surface for torch operations on a device."""
    topology = replace(surface.topology, faces=surface.topology.faces.to(device))
    return replace(surface, topology=topology, vertices=surface.vertices.to(device))


def bent_inwards(groom: Groom, batch: int = 2, seed: int = 3) -> tuple[torch.Tensor, torch.Tensor]:
    """Draped positions [b s n 3] away from rest, a part of them inside the sphere, and the directors [b s e 3]."""
    generator = torch.Generator().manual_seed(seed)
    posed = groom.rest_strands.expand(batch, -1, -1, -1)
    noise = 0.01 * torch.randn(posed.shape, generator=generator)
    noise[:, :, 0] = 0
    pulled = posed.clone()
    pulled[:, ::2, 1:] = 0.75 * pulled[:, ::2, 1:].flip(2) - 0.06
    return pulled + noise, directors(posed)
