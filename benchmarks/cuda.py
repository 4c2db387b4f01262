"""Drapes, energies and their gradients on a CUDA device against the CPU, and how long they take there.

    python benchmarks/cuda.py [--groom bob] [--batches 1 8 64]

Prints the differences of drape, energy and gradient, and the time of some batches.
"""

import argparse
import statistics
import time
from collections.abc import Callable
from functools import partial

import torch

import quaffure as qf
from quaffure.backend import Backend
from quaffure.body import load_pose_prior
from quaffure.config import HairMaterial
from quaffure.energies import HairEnergy
from quaffure.energies.design_terms import terms_of_design
from quaffure.model import NeuralDraper
from quaffure.scene import BodyBatch, Scene
from quaffure.training import PoseSampler
from quaffure.types import Tensor

REPEATS, FEW = 5, 200
MATERIAL = HairMaterial()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--groom", default="bob")
    parser.add_argument("--batches", type=int, nargs="*", default=[1, 8, 64])
    parser.add_argument("--device", default="cuda")
    options = parser.parse_args()
    name = torch.cuda.get_device_name() if options.device == "cuda" else options.device
    print(f"{name}, torch {torch.__version__}, {torch.get_num_threads()} threads of the CPU")
    compare(options.groom, options.device)
    for device in ("cpu", options.device):
        time_drapes(options.groom, device, options.batches)


def bodies(count: int, seed: int = 0) -> tuple[Tensor, Tensor]:
    """Poses and shapes of the pose prior."""
    return PoseSampler(load_pose_prior()).sample(count, 1, torch.Generator().manual_seed(seed))


def compare(name: str, device: str) -> None:
    """Print the differences of the torch backend on the device from the compiled one on the CPU."""
    pose, shape = bodies(2)
    found = {}
    for backend, where in ((Backend.CPU, "cpu"), (Backend.TORCH, device)):
        body, groom = qf.load_body().to(where), qf.load_groom(name).to(where)
        scene = Scene(groom, BodyBatch(body, pose.to(where), shape.to(where)))
        hair = draper_on(where, backend).drape(scene).cpu()
        # Of the same hair on both: what touches in one drape may not touch in the other.
        same = (hair if backend is Backend.CPU else found[Backend.CPU][0])[:, :FEW].to(where).requires_grad_()
        few = Scene(groom.select(torch.arange(FEW, device=where)), scene.bodies)
        energy = HairEnergy(few.groom, MATERIAL, terms_of_design(few.groom, body, MATERIAL), backend)
        total = energy.total(same, few)
        (gradient,) = torch.autograd.grad(total.sum(), same)
        found[backend] = hair, total.detach().cpu(), gradient.cpu()
    for what, expected, values in zip(("drape [m]", "energy [J]", "gradient [N]"), *found.values()):
        difference, size = (values - expected).abs().flatten(), float(expected.abs().max())
        largest, most = float(difference.max()), float(difference.quantile(0.99))
        print(f"{what}: differs by {largest:.3g} at most, {most:.3g} at the 99th percentile; at most {size:.3g}")
    pose = pose.to(device).requires_grad_()
    few = Scene(groom.select(torch.arange(FEW, device=device)), BodyBatch(body, pose, shape.to(device)))
    (by_pose,) = torch.autograd.grad(draper_on(device, Backend.TORCH).deform(few).sum(), pose)
    print(f"derivative by the pose: finite {bool(by_pose.isfinite().all())}, norm {float(by_pose.norm()):.4g}")


def draper_on(device: str, backend: Backend) -> NeuralDraper:
    """The shipped network in float32."""
    draper = qf.load_model(device=device, bf16=False).draper
    return NeuralDraper(draper.network, draper.material, backend=backend)


def time_drapes(name: str, device: str, batches: list[int]) -> None:
    model = qf.load_model(device=device)
    groom = qf.load_groom(name).to(device)
    for count in batches:
        pose, shape = (values.to(device) for values in bodies(count))
        seconds = median_seconds(partial(model.drape, groom, pose, shape), device)
        print(f"{device}: {count} drapes of {len(groom)} strands in {1000 * seconds:.1f} ms")


def median_seconds(run: Callable[[], object], device: str) -> float:
    run()
    times = []
    for _ in range(REPEATS):
        begun = time.perf_counter()
        run()
        if device == "cuda":
            torch.cuda.synchronize()
        times.append(time.perf_counter() - begun)
    return statistics.median(times)


if __name__ == "__main__":
    main()
