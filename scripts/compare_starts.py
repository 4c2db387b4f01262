"""The table of starts in docs/training.md: `python scripts/compare_starts.py GROOM ...`, energies before any training.

Mean over six poses of the prior on random bodies; energies per vertex in m g L.
"""

import sys

import torch

from quaffure.benchmark.metrics import intersection_percent
from quaffure.body.body_model import load_body
from quaffure.body.mls_body import mls_body
from quaffure.body.pose_prior import load_pose_prior
from quaffure.config import HairMaterial
from quaffure.energies.closed_form import equilibrium_vectors
from quaffure.energies.hair_energy import HairEnergy
from quaffure.geometry.mls_surface import resolve_contact_reference
from quaffure.geometry.polyline import integrate_directions
from quaffure.hair.strand_blocks import cluster_representatives
from quaffure.io.load_groom import load_groom
from quaffure.model.initial_shape import resolve_contact_twice
from quaffure.model.initial_shape_kernels import PROPAGATED_SHARE
from quaffure.model.prepared_groom import initial_clearance
from quaffure.scene import BodyBatch, Scene
from quaffure.training.pose_sampler import PoseSampler

POSES, SEED = 6, 20_000
SHARES = (0.15, PROPAGATED_SHARE, 0.5)


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
            terms = energy.by_term(hair, scene)
            means = {key: float(energy.per_vertex(value).mean()) for key, value in terms.items()}
            inside = float(intersection_percent(hair, scene).mean())
            print(
                f"| {groom.name} | {start} | {means['stretch_shear'] + means['stretch']:.3f} | {means['gravity']:.3f} |"
                f" {means['body_collision']:.3f} | {means['self_collision']:.3f} | {inside:.2f} |"
            )


def _starts(scene: Scene, energy: HairEnergy) -> dict[str, torch.Tensor]:
    rest, body, root = energy.rest, scene.bodies.body, scene.posed[:, :, 0]
    gravity = equilibrium_vectors(scene.director, rest.rest_length, rest.mass_beyond, energy.material.k_cosserat)
    surface = mls_body(body, scene.bodies.posed)
    layered = initial_clearance(scene.groom, rest, energy.material, body)
    margins = {"contact resolved": rest.collision_margin, "contact resolved in layers": layered}
    once = {
        name: resolve_contact_reference(root, gravity, rest.rest_length, margin, surface)[0]
        for name, margin in margins.items()
    }
    each, clusters = torch.arange(len(scene.groom)), cluster_representatives(scene.groom)

    def twice(representatives: torch.Tensor, share: float) -> torch.Tensor:
        return resolve_contact_twice(root, gravity, rest.rest_length, layered, surface, representatives, share)[0]

    resolved = {
        f"contact resolved twice, {share:g} of the force propagated": twice(clusters, share) for share in SHARES
    }
    resolved[f"the same with {PROPAGATED_SHARE:g}, each strand for itself"] = twice(each, PROPAGATED_SHARE)
    return {"posed": scene.director, "gravity equilibrium": gravity, **once, **resolved}


if __name__ == "__main__":
    main(sys.argv[1:])
