"""The table of starts in docs/training.md: `python scripts/compare_starts.py GROOM ...`, energies before any training.

Mean over six poses of the prior on random bodies; energies per vertex in m g L.
"""

import sys

import torch

from quaffure.benchmark import intersection_percent
from quaffure.body import load_body, load_pose_prior
from quaffure.body.mls_body import mls_body
from quaffure.config import HairMaterial
from quaffure.energies import HairEnergy, equilibrium_vectors
from quaffure.geometry import integrate_directions, resolve_contact_reference
from quaffure.hair import cluster_representatives
from quaffure.io.load_groom import load_groom
from quaffure.model import InitialShapeConfig, initial_clearance, resolve_contact_twice
from quaffure.scene import BodyBatch, Scene
from quaffure.training import PoseSampler

POSES, SEED = 6, 20_000
CONFIG = InitialShapeConfig()
SHARES = (0.15, CONFIG.propagated_share, 0.5)


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
    free = equilibrium_vectors(scene.director, rest.rest_length, rest.mass_beyond, energy.material.k_cosserat)
    surface = mls_body(body, scene.bodies.posed, CONFIG.body)
    layered = initial_clearance(scene.groom, rest, energy.material, body, CONFIG)
    margins = {"contact resolved": rest.collision_margin, "the same in layers": layered}
    once = {
        name: resolve_contact_reference(root, free, rest.rest_length, margin, surface)[0]
        for name, margin in margins.items()
    }
    alone = torch.arange(len(scene.groom))
    _, representative = cluster_representatives(scene.groom, CONFIG.cluster_size, CONFIG.cluster_radius)

    def twice(representative: torch.Tensor, share: float) -> torch.Tensor:
        return resolve_contact_twice(root, free, rest.rest_length, layered, surface, representative, share)[0]

    propagated = {f"resolved twice, {share:g} propagated": twice(representative, share) for share in SHARES}
    propagated["the same, every strand its own representative"] = twice(alone, CONFIG.propagated_share)
    return {"posed": scene.director, "equilibrium": free, **once, **propagated}


if __name__ == "__main__":
    main(sys.argv[1:])
