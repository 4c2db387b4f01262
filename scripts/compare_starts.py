"""The table of starts in docs/training.md: `python scripts/compare_starts.py GROOM ...`, energies before any training.

Mean over six poses of the prior on random bodies; energies per vertex in m g L.
"""

import sys

import torch

from quaffure.body.body_model import load_body
from quaffure.body.pose_prior import load_pose_prior
from quaffure.body.soft_body import soft_body
from quaffure.config import HairMaterial
from quaffure.drapers.fitted_groom import starting_margin
from quaffure.drapers.scene import BodyBatch, Scene
from quaffure.drapers.undeformed import slid_twice
from quaffure.drapers.undeformed_kernels import HANDED_BACK
from quaffure.energies.closed_form import sagged_vectors
from quaffure.energies.hair_energy import HairEnergy
from quaffure.evaluation.figures import intersection_percent
from quaffure.geometry.polyline import integrate_directions
from quaffure.geometry.soft_surface import slide_reference
from quaffure.groom.strand_packets import leader_of
from quaffure.io.load_groom import load_groom
from quaffure.training.pose_sampler import PoseSampler

POSES, SEED = 6, 20_000
SHARES = (0.15, HANDED_BACK, 0.5)


def main(names: list[str]) -> None:
    body = load_body()
    pose, shape = PoseSampler(load_pose_prior()).sample(POSES, 1, torch.Generator().manual_seed(SEED))
    bodies = BodyBatch(body, pose, shape)
    print("| groom | start | elastic | gravity | body contact | hair contact | inside the body [%] |")
    print("|---|---|---|---|---|---|---|")
    for name in names:
        groom = load_groom(name, body)
        scene, energy = Scene(groom, bodies), HairEnergy(groom, HairMaterial())
        for start, edges in _starts(scene, energy).items():
            hair = integrate_directions(scene.posed[:, :, 0], edges, energy.rest.rest_length)
            terms = energy.terms(hair, scene.director, scene.surface)
            means = {key: float(energy.per_vertex(value).mean()) for key, value in terms.items()}
            inside = float(intersection_percent(hair, scene).mean())
            print(
                f"| {groom.name} | {start} | {means['stretch_shear'] + means['stretch']:.3f} | {means['gravity']:.3f} |"
                f" {means['body_collision']:.3f} | {means['self_collision']:.3f} | {inside:.2f} |"
            )


def _starts(scene: Scene, energy: HairEnergy) -> dict[str, torch.Tensor]:
    rest, body, root = energy.rest, scene.bodies.body, scene.posed[:, :, 0]
    sag = sagged_vectors(scene.director, rest.rest_length, rest.mass_beyond, energy.material.k_cosserat)
    surface = soft_body(body, scene.bodies.posed)
    layered = starting_margin(scene.groom, rest, energy.material, body)
    margins = {"slid": rest.collision_margin, "slid in layers": layered}
    slid = {name: slide_reference(root, sag, rest.rest_length, margin, surface)[0] for name, margin in margins.items()}
    alone, leader = torch.arange(len(scene.groom)), leader_of(scene.groom)

    def twice(leader: torch.Tensor, share: float) -> torch.Tensor:
        return slid_twice(root, sag, rest.rest_length, layered, surface, leader, share)[0]

    handed = {f"slid twice, {share:g} handed back": twice(leader, share) for share in SHARES}
    handed[f"the same with {HANDED_BACK:g}, each feeling for itself"] = twice(alone, HANDED_BACK)
    return {"posed": scene.director, "sag": sag, **slid, **handed}


if __name__ == "__main__":
    main(sys.argv[1:])
