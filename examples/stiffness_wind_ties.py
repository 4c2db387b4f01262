"""Stiffness, wind and ties: the same hair fine, coarse and in a wind, and held where a clip would hold it.

    python examples/stiffness_wind_ties.py

`under` gives the network or a solver another loading; `held_up_to` and `tied_at` hold parts of a groom.
"""

import torch

import quaffure as qf
from quaffure.energies import Loading, held_up_to
from quaffure.scene import BodyBatch, Scene
from quaffure.solvers import StrandNewtonDraper

WIND = (0.0, -4.0, -9.81)
"""Gravity and a wind from behind [m/s^2]: z is up, the body faces -y."""


def main(strands: int = 600) -> dict[str, float]:
    """How far tips are in front of those of the plain drape, in the mean [m]."""
    model, groom = qf.load_model(), qf.load_groom("long_wavy").thinned(strands)
    pose, shape = qf.load_motion("bow").body_pose[30:31], torch.zeros(1, 10)
    plain = model.drape(groom, pose, shape)
    drapes = {
        "fine": model.with_loading(Loading(stiffness=0.3)).drape(groom, pose, shape),
        "coarse": model.with_loading(Loading(stiffness=3.0)).drape(groom, pose, shape),
        "wind": model.with_loading(Loading(acceleration=WIND)).drape(groom, pose, shape),
    }
    held = held_up_to(groom, torch.ones(len(groom), dtype=torch.bool), 0.1)  # the first ten centimetres of every strand
    drapes["held"] = StrandNewtonDraper().drape(Scene(held, BodyBatch(model.body, pose, shape)))
    found = {name: float((plain - hair)[0, :, -1, 1].mean()) for name, hair in drapes.items()}
    print({name: f"{1000 * moved:+.0f} mm" for name, moved in found.items()})
    return found


if __name__ == "__main__":
    main()
