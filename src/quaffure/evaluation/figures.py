"""Figures of merit of a drape.

Nothing here is shared with the training's loss but the physics: intersections come from an exact signed distance whose
sign is that of the angle-weighted pseudonormal.
"""

import torch

from quaffure.body.pose_features import world_from_head
from quaffure.drapers.scene import Scene
from quaffure.energies.elastic import length_errors, orientation_errors
from quaffure.energies.hair_energy import HairEnergy
from quaffure.energies.self_collision import densities, density_excesses
from quaffure.geometry.signed_distance import signed_distance
from quaffure.types import Energy, Float, Positions, Tensor

PerFrame = dict[str, Float[Tensor, " b"]]


def figures_of_merit(draped: Positions, scene: Scene, energy: HairEnergy) -> PerFrame:
    """What can be said of every drape by itself.

    Returns:
        By name, for every frame: `body_intersection_percent`, `length_error_percent`, `length_error_percent_max`,
        `orientation_error_deg`, `density_excess_percent`, and `energy` [m g L per vertex].
    """
    rest = energy.rest
    lengths = 100 * length_errors(draped, rest.rest_length)
    density = densities(draped, rest.mass, energy.material.smoothing_length)
    return {
        "body_intersection_percent": intersection_percent(draped, scene),
        "length_error_percent": lengths.mean(dim=(1, 2)),
        "length_error_percent_max": lengths.amax(dim=(1, 2)),
        "orientation_error_deg": orientation_errors(draped, scene.director).mean(dim=(1, 2)),
        "density_excess_percent": density_excesses(density, rest.rest_density).mean(dim=(1, 2)),
        "energy": total_energy(draped, scene, energy),
    }


def figures_against(draped: Positions, reference: Positions, scene: Scene, energy: HairEnergy) -> PerFrame:
    """What needs the drape of a solver beside it.

    Returns:
        By name, for every frame: `excess_energy` [m g L per vertex] and `distance_mm`; `jitter`, one figure for the
        whole clip, repeated, where there are three frames or more.
    """
    figures = {
        "excess_energy": total_energy(draped, scene, energy) - total_energy(reference, scene, energy),
        "distance_mm": 1000 * (draped - reference).norm(dim=-1).mean(dim=(1, 2)),
    }
    if len(draped) >= 3:
        ratio = acceleration(draped, scene) / acceleration(reference, scene)
        figures["jitter"] = ratio.expand(len(draped))
    return figures


def intersection_percent(draped: Positions, scene: Scene) -> Float[Tensor, " b"]:
    """Share of vertices, roots left out, strictly inside the body [%]."""
    inside = signed_distance(draped[:, :, 1:].flatten(1, 2), scene.surface) < 0
    return 100 * inside.float().mean(dim=1)


def total_energy(draped: Positions, scene: Scene, energy: HairEnergy) -> Energy:
    """Energy of every frame [m g L per vertex]."""
    return energy.per_vertex(torch.stack(list(energy.terms(draped, scene.director, scene.surface).values())).sum(0))


def acceleration(draped: Positions, scene: Scene) -> Float[Tensor, ""]:
    """Mean second difference over frames of the vertices seen from the head [m per frame^2]."""
    posed = scene.bodies.posed
    body = scene.bodies.body
    head_position = posed.joint_positions[:, body.joint_names.index("Head")]
    seen = (draped - head_position[:, None, None]) @ world_from_head(body, posed.joint_rotations)[:, None]
    return seen.diff(n=2, dim=0).norm(dim=-1).mean()
