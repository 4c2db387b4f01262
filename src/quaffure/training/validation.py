"""Metrics of a draper on bodies that no step trains on."""

from collections.abc import Iterable
from dataclasses import dataclass

import torch

from quaffure.body.pose_prior import load_pose_prior
from quaffure.draper import Draper
from quaffure.energies.body_collision import intersection_percent
from quaffure.energies.hair_energy import HairEnergy
from quaffure.energies.stretch import length_errors
from quaffure.energies.stretch_shear import orientation_errors
from quaffure.scene import Scene
from quaffure.training.pose_sampler import PoseSampler
from quaffure.types import BodyPose, BodyShape, Energy, Positions

# Hair inside the body costs as much to find as all energies do; as many strands, spread over the groom, give the share
# to a twentieth of itself.
MEASURED_STRANDS = 500
_POSES, _SEED = 16, 20_000


@dataclass(frozen=True)
class Validation:
    """Poses and shapes that no step trains on; the same at every validation."""

    body_pose: BodyPose
    body_shape: BodyShape


def prior_validation() -> Validation:
    """Poses and shapes drawn once, by a generator of their own, from the shipped prior only: frames of clips are poses
    that the network may have been trained on.
    """
    generator = torch.Generator().manual_seed(_SEED)
    return Validation(*PoseSampler(load_pose_prior()).sample(_POSES, 1, generator))


STIFF_SHARE = 0.1
"""Share of k_Cosserat in the unit of the loss: as much as a strand of 9 cm weighs, in m g L of a vertex."""


ENERGY_OFFSET, LEAST_ENERGY = 2.0, 0.1
"""The energy of a sample, in `loss_unit`, counts by its logarithm above this much less: no drape has so little."""


def energy_above_offset(total: Energy, energy: HairEnergy) -> Energy:
    """Energy of each sample above `-ENERGY_OFFSET`, in `loss_unit`; a training descends its logarithm.

    Args:
        total: the sum of the energy's terms [J].
    """
    return (total / loss_unit(energy) + ENERGY_OFFSET).clamp(min=LEAST_ENERGY)


def loss_unit(energy: HairEnergy) -> float:
    """The unit of a groom's loss [J]: m g L plus a part of k_Cosserat, a vertex.

    For long hair the first is all; in very short hair a bend costs a thousand times what its weight does, and short
    grooms would outweigh the others. With the whole of k_Cosserat the bends of short hair counted for so little that
    the network traded them for everything else.
    """
    return energy.per_vertex_unit + STIFF_SHARE * energy.rest.mass.numel() * energy.material.k_cosserat


def validation_metrics(draper: Draper, scenes: Iterable[tuple[Scene, HairEnergy]]) -> dict[str, float]:
    """Means over grooms and poses.

    Args:
        scenes: each groom on the validation bodies, and its energy.

    Returns:
        Every energy term in `loss_unit`, zero for grooms without it, their sum `energy`, the mean logarithm
        `log_energy` that a training descends (`energy_above_offset`), `body_intersection_percent` (of
        `MEASURED_STRANDS` strands of a groom), `orientation_error_deg` and `length_error_percent`.
    """
    rows = [_groom_metrics(draper.drape(scene), scene, energy) for scene, energy in scenes]
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: sum(row.get(name, 0.0) for row in rows) / len(rows) for name in names}


def _groom_metrics(draped: Positions, scene: Scene, energy: HairEnergy) -> dict[str, float]:
    terms = energy.by_term(draped, scene)
    metrics = {name: float(term.mean()) / loss_unit(energy) for name, term in terms.items()}
    metrics["energy"] = sum(metrics.values())
    metrics["log_energy"] = float(energy_above_offset(torch.stack([*terms.values()]).sum(dim=0), energy).log().mean())
    every = -(-draped.shape[1] // MEASURED_STRANDS)
    metrics["body_intersection_percent"] = float(intersection_percent(draped[:, ::every], scene).mean())
    metrics["orientation_error_deg"] = float(orientation_errors(draped, scene.director).mean())
    metrics["length_error_percent"] = float(length_errors(draped, energy.rest.rest_length).mean()) * 100
    return metrics
