"""Adam on the directions of the edges: the reference that needs no training.

Directions integrated from the root keep every rest length, so the stiff stretching term drops out and a few hundred
steps settle a groom (Kingma and Ba 2015 for the method).
"""

import math
import time

import torch

from quaffure.config import HairMaterial
from quaffure.drapers.draper import StoppingReport
from quaffure.drapers.scene import Scene
from quaffure.energies.closed_form import sagged_vectors
from quaffure.energies.force_limit import limit_forces
from quaffure.energies.hair_energy import HairEnergy
from quaffure.geometry.polyline import integrate_directions
from quaffure.types import Positions


class AdamDraper:
    """Minimizes `HairEnergy` over directions, from the closed-form sag.

    Attributes:
        steps: gradient evaluations.
        learning_rate: at the start [dimensionless change of a unit direction]; falls to a hundredth along a cosine.
    """

    name = "adam"

    def __init__(self, material: HairMaterial | None = None, steps: int = 300, learning_rate: float = 0.1) -> None:
        self.material = material or HairMaterial()
        self.steps = steps
        self.learning_rate = learning_rate

    def drape(self, scene: Scene) -> Positions:
        return self.solve(scene)[0]

    def solve(self, scene: Scene) -> tuple[Positions, StoppingReport]:
        """Draped vertices [m] and where the solver stopped."""
        start = time.perf_counter()
        energy = HairEnergy(scene.groom, self.material)
        rest = energy.rest
        sag = sagged_vectors(scene.director, rest.rest_length, rest.mass_beyond, self.material.k_cosserat)
        directions = torch.nn.functional.normalize(sag, dim=-1).requires_grad_()
        roots = scene.posed[:, :, 0]
        optimizer = torch.optim.Adam([directions], lr=self.learning_rate, betas=(0.9, 0.99), eps=1e-20)
        norms = []
        for step in range(self.steps):
            cosine = 0.5 * (1 + math.cos(math.pi * step / self.steps))
            optimizer.param_groups[0]["lr"] = self.learning_rate * (0.01 + 0.99 * cosine)
            optimizer.zero_grad()
            positions = limit_forces(integrate_directions(roots, directions, rest.rest_length), rest, 1.0)
            energy.total(positions, scene.director, scene.surface).sum().backward()
            norms.append(float(directions.grad.norm()))  # type: ignore[union-attr]
            optimizer.step()
            with torch.no_grad():
                directions.copy_(torch.nn.functional.normalize(directions, dim=-1))
        with torch.no_grad():
            positions = integrate_directions(roots, directions, rest.rest_length)
            final = energy.total(positions, scene.director, scene.surface)
        seconds = time.perf_counter() - start
        return positions, StoppingReport(float(final.mean()), norms[-1] / norms[0], self.steps, seconds)
