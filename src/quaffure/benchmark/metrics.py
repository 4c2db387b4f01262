"""Figures of merit of drapes.

Intersections are those of `quaffure.benchmark.intersection`, which no loss and no solver uses.
"""

import numpy as np
import torch

from quaffure.benchmark.intersection import winding_numbers
from quaffure.body.body_model import BodyModel
from quaffure.body.pose_features import HEAD, world_from_head
from quaffure.drape_motion import FRAMES_AT_ONCE, bodies_of, material_of
from quaffure.energies.elastic import length_errors, orientation_errors
from quaffure.energies.hair_energy import HairEnergy
from quaffure.energies.self_collision import densities, density_excesses
from quaffure.errors import InputError
from quaffure.hair.drape_sequence import DrapeSequence
from quaffure.hair.groom import Groom
from quaffure.scene import BodyBatch, Scene
from quaffure.types import Bool, Energy, Float, Positions, Tensor

PerFrame = dict[str, Float[Tensor, " b"]]


def measure(
    sequence: DrapeSequence, groom: Groom, body: BodyModel, reference: DrapeSequence | None = None
) -> tuple[PerFrame, PerFrame]:
    """Figures of merit of every frame of a drape, and of the groom as it was merely posed.

    Args:
        groom: the one that was draped.
        reference: the best solver's drape of the same groom and frames; needed for `excess_energy`, `distance_mm` and
            `jitter`, which is one figure for the clip and repeated, and left out where the reference does not move.

    Raises:
        InputError: the reference holds other frames, bodies or strands, or hair of another material.
    """
    if reference is not None:
        _check_reference(reference, sequence)
    energy = HairEnergy(groom, material_of(sequence))
    draped: list[PerFrame] = []
    posed: list[PerFrame] = []
    for start in range(0, len(sequence), FRAMES_AT_ONCE):
        chunk = slice(start, start + FRAMES_AT_ONCE)
        scene = Scene(groom, bodies_of(sequence, body, chunk))
        against = None if reference is None else torch.from_numpy(reference.strands[chunk])
        draped.append(metrics(torch.from_numpy(sequence.strands[chunk]), scene, energy, against))
        posed.append(metrics(scene.posed, scene, energy, against))
    whole = _joined(draped)
    if reference is not None and len(sequence) >= 3:
        of_reference = acceleration(reference, body)
        if of_reference > 0:
            whole["jitter"] = (acceleration(sequence, body) / of_reference).expand(len(sequence))
    return whole, _joined(posed)


def _check_reference(reference: DrapeSequence, sequence: DrapeSequence) -> None:
    if reference.strands.shape != sequence.strands.shape:
        raise InputError("reference", f"strands {sequence.strands.shape}", f"{reference.strands.shape}")
    for name in ("body_pose", "body_shape", "rest_lengths"):
        if not np.allclose(getattr(reference, name), getattr(sequence, name), atol=1e-4):
            raise InputError("reference", f"the same {name} as the drape's", "another")
    if material_of(reference) != material_of(sequence):
        raise InputError("reference", f"hair of {material_of(sequence)}", f"{material_of(reference)}")


def metrics(draped: Positions, scene: Scene, energy: HairEnergy, reference: Positions | None = None) -> PerFrame:
    """Figures of every frame by name; energies in m g L per vertex. See the table in `docs/metrics.md`."""
    rest = energy.rest
    lengths = 100 * length_errors(draped, rest.rest_length)
    density = densities(draped, rest.mass, energy.material.smoothing_length)
    figures = {
        "body_intersection_percent": intersection_percent(draped, scene),
        "length_error_percent": lengths.mean(dim=(1, 2)),
        "length_error_percent_max": lengths.amax(dim=(1, 2)),
        "orientation_error_deg": orientation_errors(draped, scene.director).mean(dim=(1, 2)),
        "density_excess_percent": density_excesses(density, rest.rest_density).mean(dim=(1, 2)),
        "energy": total_energy(draped, scene, energy),
    }
    if reference is not None:
        figures["excess_energy"] = figures["energy"] - total_energy(reference, scene, energy)
        figures["distance_mm"] = 1000 * (draped - reference).norm(dim=-1).mean(dim=(1, 2))
    return figures


def intersection_percent(draped: Positions, scene: Scene) -> Float[Tensor, " b"]:
    """Share of vertices, roots left out, that the body winds round [%]."""
    return 100 * inside_body(draped, scene).to(draped).mean(dim=(1, 2))


def inside_body(draped: Positions, scene: Scene) -> Bool[Tensor, "b s m"]:
    """Which vertices, roots left out, the body winds round."""
    points = draped[:, :, 1:].flatten(1, 2).detach().cpu().numpy()
    vertices, faces = scene.surface.vertices.detach().cpu().numpy(), scene.surface.topology.faces.cpu().numpy()
    inside = np.stack([winding_numbers(*sample, faces) > 0 for sample in zip(points, vertices)])
    return torch.from_numpy(inside).to(draped.device).view(*draped.shape[:2], -1)


def total_energy(draped: Positions, scene: Scene, energy: HairEnergy) -> Energy:
    """Energy of every frame [m g L per vertex]."""
    return energy.per_vertex(torch.stack(list(energy.terms(draped, scene.director, scene.surface).values())).sum(0))


def acceleration(sequence: DrapeSequence, body: BodyModel) -> Float[Tensor, ""]:
    """Mean second difference over frames of the draped vertices seen from the head [m per frame^2]."""
    return acceleration_from_head(torch.from_numpy(sequence.strands), bodies_of(sequence, body))


def acceleration_from_head(draped: Positions, bodies: BodyBatch) -> Float[Tensor, ""]:
    """The same of draped vertices [m, world] on the bodies of frames in a row."""
    return accelerations_from_head(draped, bodies).mean()


def accelerations_from_head(draped: Positions, bodies: BodyBatch) -> Float[Tensor, " f"]:
    """The same at each frame that has one before it and one after."""
    posed, body = bodies.posed, bodies.body
    offsets = draped - posed.joint_positions[:, body.joint_names.index(HEAD), None, None]
    return (
        (offsets @ world_from_head(body, posed.joint_rotations)[:, None]).diff(n=2, dim=0).norm(dim=-1).mean(dim=(1, 2))
    )


def _joined(parts: list[PerFrame]) -> PerFrame:
    return {name: torch.cat([part[name] for part in parts]) for name in parts[0]}
