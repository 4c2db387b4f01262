"""Every strand of a large groom on its draped guides: seconds a frame, memory, and how near it is to its source.

    python benchmarks/original_strands.py [--style long_wavy] [--strands 100000] [--motion walk] [--frames 10]

The source is a bundled style, interpolated to many strands and registered like a file. Distances are those of the
source's points: upright, from where the source has them; of strands that are draped, from the polyline of the drape.
"""

import resource
import time
from dataclasses import dataclass

import numpy as np
import torch
import tyro

from quaffure.body import bundled_clip, load_body
from quaffure.hair import Strands, interpolation_of, register_groom, select_guides
from quaffure.hair.source_strands import OriginalStrands, original_strands, place_strands
from quaffure.model.quaffure_model import load_model
from quaffure.procedural import make_groom
from quaffure.scene import BodyBatch


@dataclass(frozen=True)
class Frame:
    """A draped frame: guides and surface of the body [m, world]."""

    guides: np.ndarray
    vertices: np.ndarray


def main(style: str = "long_wavy", strands: int = 100_000, motion: str = "walk", frames: int = 10) -> None:
    body = load_body()
    made = make_groom(style, body)
    rest = body.rest_vertices.numpy()
    points = interpolation_of(made, body, strands).strands(made.rest_strands.numpy(), rest)
    source = Strands(points.reshape(-1, 3), np.full(len(points), points.shape[1]), style)
    start = time.perf_counter()
    registered, report = register_groom(source, body, style)
    groom, placed = select_guides(registered), place_strands(source, report, body)
    original = original_strands(placed, groom, body)
    print(f"{len(original)} strands on {len(groom)} guides, prepared in {time.perf_counter() - start:.1f} s")
    upright = original.points(groom.rest_strands.numpy(), rest)
    apart = 1e3 * np.linalg.norm(upright - placed.points, axis=1)
    print(f"upright: {apart.mean():.4f} mm from the source in the mean, {apart.max():.2f} mm at most")

    clip = bundled_clip(motion, body).body_pose
    poses = clip[torch.linspace(0, len(clip) - 1, frames).long()]
    bodies = BodyBatch(body, poses, torch.zeros(frames, 10))
    draped, vertices = load_model().drape(groom, poses).numpy(), bodies.posed.vertices.numpy()
    seconds, found = [], upright
    for guides, surface in zip(draped, vertices):
        wall, own = time.perf_counter(), time.process_time()
        found = original.points(guides, surface)
        seconds.append((time.perf_counter() - wall, time.process_time() - own))
    wall, own = np.median(seconds, axis=0)
    print(f"a frame: {wall:.2f} s, {own:.2f} s of processor time")
    print(f"strands that are draped: {1e3 * distance_from_drape(original, found, draped[-1]):.5f} mm from it at most")
    print(f"memory: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.2f} GB at most")


def distance_from_drape(original: OriginalStrands, points: np.ndarray, guides: np.ndarray) -> float:
    """Largest distance of a point of a strand that is draped from the polyline of its drape [m]."""
    starts, worst = np.concatenate([[0], original.counts.cumsum()]), 0.0
    for strand in np.flatnonzero(original.own_guide >= 0):
        polyline, own = guides[original.own_guide[strand]].astype(float), points[starts[strand] : starts[strand + 1]]
        edges = np.diff(polyline, axis=0)
        offsets = own[:, None] - polyline[:-1]
        share = ((offsets * edges).sum(-1) / (edges**2).sum(-1)).clip(0, 1)
        worst = max(worst, np.linalg.norm(offsets - share[..., None] * edges, axis=-1).min(axis=1).max())
    return worst


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
