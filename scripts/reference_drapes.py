"""Saves drapes, energies and gradients of one commit, and compares another commit with them.

python scripts/reference_drapes.py save reference.npz      # before a change that must not alter results
python scripts/reference_drapes.py compare reference.npz   # after it

Drapes may differ by 1 um in float32 and by 0.05 mm in bfloat16, energies and gradients by 1e-6 of their size. Exit code
1 where they differ by more. The arrays are some 30 MB and are not kept in the repository.
"""

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

import quaffure as qf
from quaffure.body import bundled_clip
from quaffure.energies import HairEnergy
from quaffure.energies.by_name import hair_terms
from quaffure.scene import BodyBatch, Scene

GROOMS = ("long_straight", "bob", "long_ringlets", "crew_cut")
FRAMES = {"neck_turn": (0, 35), "bow": (60,), "walk": (10,)}
MODELS = ("modified_cosserat", "cosserat", "mass_spring")
FLOAT32_TOLERANCE, BFLOAT16_TOLERANCE, ENERGY_TOLERANCE = 1e-6, 5e-5, 1e-6
"""Largest distance of a vertex [m], twice; largest relative difference."""


def bodies() -> BodyBatch:
    """The mean body in frames of bundled clips, and one tall body."""
    body = qf.load_body()
    poses = torch.cat([bundled_clip(name, body).body_pose[list(frames)] for name, frames in FRAMES.items()])
    shapes = torch.zeros(len(poses), 10)
    shapes[-1, :3] = torch.tensor([1.5, -1.0, 0.5])
    return BodyBatch(body, poses, shapes)


def states(scene: Scene, draped: torch.Tensor) -> Iterator[tuple[str, torch.Tensor]]:
    """Three fixed states of a groom: posed, draped by the network, and bent at random."""
    yield "posed", scene.posed
    yield "draped", draped
    noise = 0.002 * torch.randn(scene.posed.shape, generator=torch.Generator().manual_seed(0)).cumsum(dim=2)
    noise[:, :, 0] = 0
    yield "bent", scene.posed + noise


def arrays() -> dict[str, np.ndarray]:
    """Every result by name: drapes [m], energies [J] and gradients [N]."""
    on, found = bodies(), {}
    # Posed in torch: the last digits of the compiled kinematics must not decide what an energy is compared on.
    fixed_bodies = replace(on, vertices=on.body.pose(on.body_pose, on.body_shape).vertices)
    for name in GROOMS:
        groom = qf.load_groom(name)
        for kind, bf16 in (("float32", False), ("bfloat16", True)):
            draped = qf.load_model(bf16=bf16).drape(groom, on.body_pose, on.body_shape)
            found[f"drape/{kind}/{name}"] = draped.numpy()
        scene = Scene(groom, fixed_bodies).sample(2)
        fixed = dict(states(scene, torch.from_numpy(found[f"drape/float32/{name}"][2:3])))
        for model in MODELS:
            energy = HairEnergy(groom, terms=hair_terms(model))
            for state, positions in fixed.items():
                x = positions.clone().requires_grad_()
                total = energy.total(x, scene)
                (gradient,) = torch.autograd.grad(total.sum(), x)
                found[f"energy/{model}/{state}/{name}"] = total.detach().numpy()
                found[f"gradient/{model}/{state}/{name}"] = gradient.numpy()
    return found


def difference(name: str, before: np.ndarray, after: np.ndarray) -> tuple[float, float]:
    """How far two results are apart, and how far they may be."""
    apart = after.astype(np.float64) - before
    if name.startswith("drape"):
        tolerance = FLOAT32_TOLERANCE if "/float32/" in name else BFLOAT16_TOLERANCE
        return float(np.linalg.norm(apart, axis=-1).max()), tolerance
    return float(np.linalg.norm(apart) / np.linalg.norm(before)), ENERGY_TOLERANCE


def main() -> int:
    """Save or compare, as the command line says; the exit code."""
    verb, path = sys.argv[1], Path(sys.argv[2])
    if verb == "save":
        np.savez(path, **arrays())
        return 0
    failed = 0
    with np.load(path, allow_pickle=False) as before:
        after = arrays()
        for name in before.files:
            apart, tolerance = difference(name, before[name], after[name])
            failed += not apart <= tolerance
            print(f"{name:50s} {apart:.2e}{'' if apart <= tolerance else '  too much'}")
    return min(failed, 1)


if __name__ == "__main__":
    sys.exit(main())
