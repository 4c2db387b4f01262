"""The derivative of a drape in the pose: how tips move when the neck bends, checked against differences.

    python examples/gradient_in_pose.py

The torch backend differentiates the whole drape but the projection out of the skin, so poses, shapes and the stiffness
of each edge can be fitted to hair by gradient descent. Differences of so small a step need double precision, gradients
do not.
"""

import torch

import quaffure as qf
from quaffure.backend import Backend
from quaffure.model import NeuralDraper
from quaffure.scene import BodyBatch, Scene

STEP = 1e-7  # rad


def main(strands: int = 100) -> dict[str, float]:
    """Derivative of the tips' mean height by a bend of the neck, from autograd and from differences [m/rad]."""
    model, body = qf.load_model(), qf.load_body().to("cpu", torch.float64)
    groom = qf.load_groom("long_wavy").thinned(strands).to(torch.float64)
    draper = NeuralDraper(model.draper.network.double(), model.draper.material, backend=Backend.TORCH)
    neck = 3 * body.joint_names.index("Neck")

    def tip_height(bend: torch.Tensor) -> torch.Tensor:
        pose = torch.zeros(1, 81, dtype=torch.float64)
        pose[0, neck] = bend
        bodies = BodyBatch(body, pose, torch.zeros(1, 10, dtype=torch.float64))
        return draper.deform(Scene(groom, bodies))[0, :, -1, 2].mean()

    bend = torch.tensor(0.4, dtype=torch.float64, requires_grad=True)
    (gradient,) = torch.autograd.grad(tip_height(bend), bend)
    with torch.no_grad():
        difference = (tip_height(bend + STEP) - tip_height(bend - STEP)) / (2 * STEP)
    found = {"autograd": float(gradient), "differences": float(difference)}
    print({name: f"{1000 * value:.2f} mm/rad" for name, value in found.items()})
    return found


if __name__ == "__main__":
    main()
