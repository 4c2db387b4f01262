"""Contact with the body, Eq. 10."""

from typing import Any

import numpy as np
import torch
from numba import njit

from quaffure.energies.energy_term import EnergyTerm, HairState
from quaffure.geometry.signed_distance import signed_distance
from quaffure.geometry.winding_number import is_inside
from quaffure.scene import HairScene
from quaffure.types import Bool, Energy, Float, Positions, Scalar, Tensor


def energy_body_collision(
    distance: Float[Tensor, "b s n"], margin: Float[Tensor, "s n"], k_body_collision: Scalar
) -> Energy:
    """Eq. 10: k_bc times the cubed shortfall of the distance d(x) below the margin D.

    Args:
        distance: signed distance to the body, positive outside [m].
        margin: D of every vertex [m].
        k_body_collision: k_bc [J/m^3].

    Returns:
        Energy [J]; zero, with zero gradient, where the distance is at least the margin.
    """
    return k_body_collision * (margin - distance).clamp(min=0).pow(3).sum(dim=(-2, -1))


@njit(cache=True, fastmath=True, inline="always")
def contact_force(distance: float, margin: float, k_body_collision: float | np.floating) -> tuple[Any, Any]:
    """Eq. 10: the derivative by the signed distance [N], -3 k_bc (D - d)^2, and the energy [J], 0 from the margin on.

    Kernels inline it.

    Args:
        distance, margin: d and D [m].
        k_body_collision: k_bc [J/m^3].
    """
    short = max(margin - distance, np.float32(0.0))
    return -(np.float32(3.0) * k_body_collision * short * short), k_body_collision * short * short * short


@njit(cache=True, fastmath=True, inline="always")
def contact_stiffness(short: float, k_body_collision: float | np.floating) -> Any:
    """Eq. 10: the second derivative by the signed distance, 6 k_bc (D - d) [N/m].

    Args:
        short: D - d, not negative [m].
        k_body_collision: k_bc [J/m^3].
    """
    return np.float32(6.0) * k_body_collision * short


def distances_to_body(positions: Positions, scene: HairScene) -> Float[Tensor, "b s n"]:
    """d(x) of Eq. 10: exact signed distance of every vertex to the body [m], positive outside."""
    return signed_distance(positions.flatten(1, 2), scene.surface).reshape(positions.shape[:3])


def intersection_percent(draped: Positions, scene: HairScene) -> Float[Tensor, " b"]:
    """`body_intersection_percent`: share of vertices, roots left out, inside the body [%]."""
    return 100 * inside_body(draped, scene).to(draped).mean(dim=(1, 2))


def inside_body(draped: Positions, scene: HairScene) -> Bool[Tensor, "b s m"]:
    """Which vertices, roots left out, are inside the body (`quaffure.geometry.winding_number`)."""
    points, vertices = (values.detach().cpu().numpy() for values in (draped[:, :, 1:], scene.surface.vertices))
    faces = scene.surface.topology.faces.cpu().numpy()
    inside = np.stack([is_inside(*sample, faces) for sample in zip(points, vertices)])
    return torch.from_numpy(inside).to(draped.device)


class BodyCollision(EnergyTerm):
    """Eq. 10."""

    name = "body_collision"
    equation = "Eq. 10"
    metric_unit = "mm"

    def energy(self, hair: HairState, scene: HairScene) -> Energy:
        distance = distances_to_body(hair.positions, scene)
        return energy_body_collision(distance, hair.rest.collision_margin, hair.material.k_body_collision)

    def metric(self, hair: HairState, scene: HairScene) -> Float[Tensor, "b s n"]:
        """Shortfall of every vertex's distance below its margin [mm]."""
        return 1000 * (hair.rest.collision_margin - distances_to_body(hair.positions, scene)).clamp(min=0)
