"""Metrics of drapes.

Intersections are those of `quaffure.geometry.winding_number`, which no loss and no solver uses.
"""

from collections.abc import Sequence

import numpy as np
import torch

from quaffure.benchmark.appearance import JUMP_SPEED, in_the_air, jumps, off_vertical
from quaffure.body.body_model import BodyModel
from quaffure.body.pose_features import HEAD, world_from_head
from quaffure.config import HairMaterial
from quaffure.drape_motion import FRAMES_AT_ONCE, bodies_of, material_of
from quaffure.energies.body_collision import intersection_percent
from quaffure.energies.energy_term import Terms
from quaffure.energies.hair_energy import HairEnergy
from quaffure.energies.self_collision import densities, density_excesses
from quaffure.energies.stretch import length_errors
from quaffure.energies.stretch_shear import orientation_errors
from quaffure.errors import InputError
from quaffure.hair.drape_sequence import DrapeSequence
from quaffure.hair.groom import Groom
from quaffure.scene import BodyBatch, HairScene, Scene
from quaffure.types import Energy, Float, Positions, Tensor

PerFrame = dict[str, Float[Tensor, " b"]]
ENERGY_UNIT = "m g L per vertex"
UNITS = {
    "body_intersection_percent": "%",
    "length_error_percent": "%",
    "length_error_percent_max": "%",
    "orientation_error_deg": "deg",
    "density_excess_percent": "%",
    "off_vertical_deg": "deg",
    "in_the_air_percent": "%",
    "energy": ENERGY_UNIT,
    "excess_energy": ENERGY_UNIT,
    "distance_mm": "mm",
    "jumps": "tips",
    "largest_jump_mm": "mm",
    "jitter": "of the reference",
}
"""Unit of every metric, by its name."""


class DrapeMetrics:
    """Metrics of a drape, and of the groom as it was posed, added up batch by batch of its frames."""

    def __init__(
        self,
        groom: Groom,
        material: HairMaterial,
        reference: DrapeSequence | None = None,
        terms: Terms | None = None,
        fps: float = 30.0,
    ) -> None:
        """
        Args:
            groom: the one that is draped.
            material: of the draped hair.
            terms: of the energy that is measured; `hair_terms()` where none are given.
            reference: the best solver's drape of the same groom and frames; needed for `excess_energy`, `distance_mm`
                and `jitter`, which is one number for the clip and repeated, and left out where the reference does not
                move.
            fps: frames per second, for `jumps`.

        Raises:
            InputError: the reference is of hair of another material.
        """
        if reference is not None and material_of(reference) != material:
            raise InputError("reference", f"hair of {material}", f"{material_of(reference)}")
        self.energy = HairEnergy(groom, material, terms)
        self._jump = JUMP_SPEED / fps
        self.reference = None if reference is None else reference.in_place()
        self._draped: list[PerFrame] = []
        self._posed: list[PerFrame] = []
        self._from_head: list[tuple[Positions, Positions]] = []
        self._jumps: list[Float[Tensor, "f s"]] = []
        self._last: tuple[Positions, Positions] | None = None
        self._frames = 0

    def add(self, draped: Positions, scene: Scene) -> None:
        """Measure the next frames, which follow those added before.

        Raises:
            InputError: the reference holds other frames, bodies or strands.
        """
        reference = None
        if self.reference is not None:
            chunk = slice(self._frames, self._frames + len(draped))
            _check_reference(self.reference, chunk, draped, scene)
            reference = torch.from_numpy(self.reference.strands[chunk])
            both = (vertices_from_head(hair, scene.bodies) for hair in (draped, reference))
            self._from_head.append((next(both), next(both)))
        self._draped.append(metrics(draped, scene, self.energy, reference))
        self._posed.append(metrics(scene.posed, scene, self.energy, reference))
        self._frames += len(draped)
        hair = draped, scene.posed
        consecutive = hair if self._last is None else [torch.cat(parts) for parts in zip(self._last, hair)]
        self._jumps.append(jumps(*consecutive))
        self._last = draped[-1:], scene.posed[-1:]

    def of_all_frames(self) -> tuple[PerFrame, PerFrame]:
        """Metrics of every frame of the drape, and of the posed groom."""
        whole = _joined(self._draped)
        if self._frames >= 2:
            moved = torch.cat(self._jumps)
            moved = torch.cat([torch.zeros_like(moved[:1]), moved])  # none leads to the first frame
            whole |= {"jumps": (moved > self._jump).sum(dim=1).to(moved), "largest_jump_mm": 1000 * moved.amax(dim=1)}
        if self._from_head and self._frames >= 3:
            own, of_reference = (accelerations(torch.cat(part)).mean() for part in zip(*self._from_head))
            if of_reference > 0:
                whole["jitter"] = (own / of_reference).expand(self._frames)
        return whole, _joined(self._posed)


def excess_energies(
    energy: HairEnergy, scene: HairScene, drapes: Sequence[Positions], others: Sequence[Positions]
) -> list[float]:
    """Energy of each drape of a sample above the lowest of all of these and of the `others` [m g L per vertex]."""
    found = [float(energy.per_vertex(energy.total(hair, scene))) for hair in (*drapes, *others)]
    return [own - min(found) for own in found[: len(drapes)]]


def measure(
    sequence: DrapeSequence,
    groom: Groom,
    body: BodyModel,
    reference: DrapeSequence | None = None,
    terms: Terms | None = None,
) -> tuple[PerFrame, PerFrame]:
    """Metrics of every frame of a drape that exists already, and of the groom as it was posed.

    Args:
        reference, terms: see `DrapeMetrics`.

    Raises:
        InputError: the reference holds other frames, bodies or strands, or hair of another material.
    """
    if reference is not None and reference.strands.shape != sequence.strands.shape:
        raise InputError("reference", f"strands {sequence.strands.shape}", f"{reference.strands.shape}")
    measured = DrapeMetrics(groom, material_of(sequence), reference, terms, sequence.fps)
    sequence = sequence.in_place()
    for start in range(0, len(sequence), FRAMES_AT_ONCE):
        chunk = slice(start, start + FRAMES_AT_ONCE)
        scene = Scene(groom, bodies_of(sequence, body, chunk))
        measured.add(torch.from_numpy(sequence.strands[chunk]), scene)
    return measured.of_all_frames()


def _check_reference(reference: DrapeSequence, frames: slice, draped: Positions, scene: Scene) -> None:
    found = reference.strands[frames].shape
    if found != draped.shape:
        raise InputError("reference", f"strands {tuple(draped.shape)}", f"{found}")
    for name, own, other in (
        ("body_pose", scene.bodies.body_pose, reference.body_pose[frames]),
        ("body_shape", scene.bodies.body_shape, reference.body_shape),
        ("rest_lengths", scene.groom.rest_lengths, reference.rest_lengths),
    ):
        if not np.allclose(own.numpy(), other, atol=1e-4):
            raise InputError("reference", f"the same {name} as the drape's", "another")


def metrics(draped: Positions, scene: HairScene, energy: HairEnergy, reference: Positions | None = None) -> PerFrame:
    """Metrics of every frame by name; energies in m g L per vertex. See the table in `docs/metrics.md`."""
    rest = energy.rest
    lengths = 100 * length_errors(draped, rest.rest_length)
    density = densities(draped, rest.mass, energy.material.smoothing_length)
    values = {
        "body_intersection_percent": intersection_percent(draped, scene),
        "length_error_percent": lengths.mean(dim=(1, 2)),
        "length_error_percent_max": lengths.amax(dim=(1, 2)),
        "orientation_error_deg": orientation_errors(draped, scene.director).mean(dim=(1, 2)),
        "density_excess_percent": density_excesses(density, rest.rest_density).mean(dim=(1, 2)),
        "off_vertical_deg": off_vertical(draped),
        "in_the_air_percent": 100 * in_the_air(draped, scene).float().mean(dim=(1, 2)),
        "energy": total_energy(draped, scene, energy),
    }
    if reference is not None:
        values["excess_energy"] = values["energy"] - total_energy(reference, scene, energy)
        values["distance_mm"] = 1000 * (draped - reference).norm(dim=-1).mean(dim=(1, 2))
    return values


def total_energy(draped: Positions, scene: HairScene, energy: HairEnergy) -> Energy:
    """Energy of every frame [m g L per vertex]."""
    return energy.per_vertex(energy.total(draped, scene))


def vertices_from_head(draped: Positions, bodies: BodyBatch) -> Positions:
    """Draped vertices in the frame of the head [m]."""
    posed, body = bodies.posed, bodies.body
    offsets = draped - posed.joint_positions[:, body.joint_names.index(HEAD), None, None]
    return offsets @ world_from_head(body, posed.joint_rotations)[:, None]


def accelerations(vertices: Positions) -> Float[Tensor, " f"]:
    """Mean second difference of vertices, at each of the frames that has one before it and one after
    [m per frame^2].
    """
    return vertices.diff(n=2, dim=0).norm(dim=-1).mean(dim=(1, 2))


def _joined(parts: list[dict[str, Tensor]]) -> PerFrame:
    return {name: torch.cat([part[name] for part in parts]) for name in parts[0]}
