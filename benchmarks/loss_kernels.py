"""What a value and gradient of the loss cost, and how exact its contact is.

    python benchmarks/loss_kernels.py [GROOM ...] [--batch 8] [--threads 2] [--json]
    python benchmarks/loss_kernels.py --contact CLIP [CLIP ...] [--json]

The first prints milliseconds a sample, median of five, of the strand kernel (Eqs. 6, 7, 9, 10), of hair against hair
(Eqs. 11-13) and of a posed body with its contact search, for hair as posed, bent at random, as an untrained network
leaves it (the closed-form gravity equilibrium, much of it inside the body) and as the shipped network drapes it. With
the wall time stands the time of all processors over the number of threads: the same on an idle machine, and of use on
a busy one.

The second compares distance and sign with libigl's exact query, over frames of motion clips on three bodies.
"""

import argparse
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import igl
import numba
import numpy as np
import torch

from quaffure.apps.cli.console import print_json, print_rows
from quaffure.benchmark import load_evaluation_set
from quaffure.body import BodyModel, load_body, load_pose_prior, resample
from quaffure.energies import HairEnergy, equilibrium_vectors
from quaffure.geometry import FREE, FREE_DISTANCE, OUTSIDE, Surface, classify, integrate_directions, occupancy_of
from quaffure.geometry.signed_distance import signed_distance
from quaffure.io.load_groom import load_groom
from quaffure.io.read_motion import read_motion
from quaffure.model import load_model
from quaffure.procedural import make_groom
from quaffure.scene import BodyBatch, Scene
from quaffure.training import PoseSampler
from quaffure.types import Positions

VERTICES = 2000 * 24
"""Of the sample that the figures are scaled to."""
FRAMES_OF_A_CLIP, SHAPES = 6, 3
ROUNDING = 1e-5
"""Nearer than this [m], which side a point is on is a matter of rounding."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("grooms", nargs="*", default=["long_straight"])
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--threads", type=int, default=numba.get_num_threads())
    parser.add_argument("--contact", nargs="+", metavar="CLIP", type=Path)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    numba.set_num_threads(options.threads)
    torch.set_num_threads(options.threads)
    body = load_body()
    if options.contact:
        rows, title = contact_rows(body, options.contact), "Contact against libigl"
    else:
        rows = [row for name in options.grooms for row in kernel_rows(body, name, options.batch)]
        title = f"ms a sample of 2,000 strands x 24, {options.threads} threads: wall time, processor time / threads"
    if options.json:
        print_json(rows)
    else:
        print_rows(rows, title)


def kernel_rows(body: BodyModel, name: str, batch: int) -> list[dict[str, object]]:
    groom = load_groom(name, body)
    poses, shapes = PoseSampler(load_pose_prior()).sample(batch, 1, torch.Generator().manual_seed(0))
    scene = Scene(groom, BodyBatch(body, poses, shapes))
    energy = HairEnergy(groom)
    share = batch * energy.rest.mass.numel() / VERTICES
    body_wall, body_cpu = cost(lambda: BodyBatch(body, poses, shapes).surface, batch)

    rows: list[dict[str, object]] = []
    for state, draped in states(scene, energy).items():
        strands = cost(lambda x=draped: with_gradient(energy.without("self_collision"), x, scene), share)
        density = cost(lambda x=draped: with_gradient(energy.only("self_collision"), x, scene), share)
        inside = (signed_distance(draped.flatten(1, 2), scene.surface) < 0).float().mean()
        rows.append(
            {
                "groom": groom.name,
                "strands": len(groom),
                "state": state,
                "inside_percent": 100 * float(inside),
                "strand_wall_ms": strands[0],
                "strand_cpu_ms": strands[1],
                "density_wall_ms": density[0],
                "density_cpu_ms": density[1],
                "body_wall_ms": body_wall,
                "body_cpu_ms": body_cpu,
            }
        )
    return rows


def states(scene: Scene, energy: HairEnergy) -> dict[str, Positions]:
    """Hair at four stages of a training run."""
    rest, roots = energy.rest, scene.posed[:, :, 0]
    gravity = equilibrium_vectors(scene.director, rest.rest_length, rest.mass_beyond, energy.material.k_cosserat)
    generator = torch.Generator().manual_seed(1)
    bend = torch.randn(*scene.director.shape[:2], 1, 3, generator=generator)
    bend = scene.director + bend * torch.linspace(0, 1, scene.director.shape[2])[:, None]
    with torch.no_grad():
        return {
            "posed": scene.posed.contiguous(),
            "bent": integrate_directions(roots, bend, rest.rest_length),
            "gravity equilibrium": integrate_directions(roots, gravity, rest.rest_length),
            "network": load_model().draper.drape(scene),
        }


def with_gradient(energy: HairEnergy, positions: Positions, scene: Scene) -> None:
    energy.total(positions.requires_grad_(), scene).sum().backward()


def cost(work: Callable[[], object], samples: float) -> tuple[float, float]:
    """Median wall time, and processor time over threads, of a sample [ms]."""
    work()
    walls, processors = [], []
    for _ in range(5):
        wall, processor = time.perf_counter(), time.process_time()
        work()
        walls.append(time.perf_counter() - wall)
        processors.append((time.process_time() - processor) / numba.get_num_threads())
    return 1000 * statistics.median(walls) / samples, 1000 * statistics.median(processors) / samples


def contact_rows(body: BodyModel, clips: list[Path]) -> list[dict[str, object]]:
    """One row a clip: the worst of its frames, on three bodies."""
    groom = make_groom("long_straight", body).select(torch.arange(0, 2400, 12))
    rows: list[dict[str, object]] = []
    for clip in clips:
        motion = resample(read_motion(clip, body), 30.0)
        frames = torch.linspace(0, len(motion) - 1, FRAMES_OF_A_CLIP).long()
        shapes = torch.randn(SHAPES, 10, generator=torch.Generator().manual_seed(2)).clamp(-2.5, 2.5)
        shapes[0] = 0
        pose = motion.body_pose[frames].repeat(SHAPES, 1)
        scene = Scene(groom, BodyBatch(body, pose, shapes.repeat_interleave(FRAMES_OF_A_CLIP, dim=0)))
        points = queries(scene)
        distance = signed_distance(points, scene.surface).double().numpy()
        found = [compared(points[k], distance[k], scene.surface, k) for k in range(len(points))]
        rows.append(
            {"clip": clip.stem, "held_out": clip.stem in load_evaluation_set().motions, "bodies": len(found)}
            | {"points": sum(int(each["points"]) for each in found)}
            | {"largest_error_mm": max(each["largest_error_mm"] for each in found)}
            | {name: sum(int(each[name]) for each in found) for name in ("other_sign", "wrong_map")}
            | {"other_winding_percent": statistics.mean(each["other_winding_percent"] for each in found)}
        )
    return rows


def queries(scene: Scene) -> torch.Tensor:
    """Points of hair, posed and draped, and points within 2 cm of the skin all over the body [b p 3]."""
    generator = torch.Generator().manual_seed(3)
    vertices = scene.bodies.posed.vertices
    shell = vertices[:, torch.randint(vertices.shape[1], (6000,), generator=generator)]
    shell = shell + 0.02 * (2 * torch.rand(shell.shape, generator=generator) - 1)
    settled = states(scene, HairEnergy(scene.groom))["gravity equilibrium"]
    return torch.cat([scene.posed.flatten(1, 2), settled.flatten(1, 2), shell], dim=1)


def compared(points: torch.Tensor, found: np.ndarray, surface: Surface, sample: int) -> dict[str, float]:
    """Errors of one body's distances `found` [p] at `points` [p 3], in metres, and of its map."""
    exact_points, vertices = points.double().numpy(), surface.vertices[sample].double().numpy()
    faces = surface.topology.faces.numpy()
    exact = igl.signed_distance(exact_points, vertices, faces, sign_type=igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL)[0]
    winding = igl.fast_winding_number(vertices, faces, exact_points)
    space = occupancy_of(surface.sample_arrays(sample))
    known = np.array([classify(*point, space) for point in points.numpy()])
    matters = np.abs(exact) > ROUNDING
    return {
        "points": len(points),
        "largest_error_mm": 1000 * float(np.abs(np.abs(found) - np.abs(exact)).max()),
        "other_sign": int(((found < 0) != (exact < 0))[matters].sum()),
        "wrong_map": int(((known == FREE) & (exact < FREE_DISTANCE)).sum() + ((known == OUTSIDE) & (exact < 0)).sum()),
        "other_winding_percent": 100 * float(((found < 0) != (winding > 0.5))[matters].mean()),
    }


if __name__ == "__main__":
    main()
