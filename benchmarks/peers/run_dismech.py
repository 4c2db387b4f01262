"""dismech-newton: discrete elastic rods by strain-space ADMM, with contact against the body's mesh and between hairs.

    env/dismech/bin/python run_dismech.py scene.npz --out dismech.npz

A separate program under GPL-3.0, called by its public interface in its own environment (`set_up.sh dismech`).
"""

from importlib.metadata import version

import newton
import numpy as np
import warp as wp
from dismech_newton import DiSMechSolver
from peer_run import SceneArrays, run

TIME_STEP = 1 / 240
ITERATIONS = 10
"""Of ADMM in a step: the solver's default."""
STRETCH_RIGIDITY = 1.0
"""EA [N], a twentieth of a hair's: stretched by 2e-3 % under its own weight, and far better conditioned."""
DAMPING_SECONDS = 0.05
"""Damping of bend and twist over their stiffness. Without, 5 strands came to rest, but of 100 that touch some began to
flail after 0.5 s and blew up by 0.8 s."""
FRICTION = 0.0


class Dismech:
    """Rods clamped by their first edge, as particles and twists of one `newton.Model`."""

    time_step = TIME_STEP

    def __init__(self, scene: SceneArrays) -> None:
        builder = newton.ModelBuilder(gravity=(0.0, 0.0, -float(scene["gravity"])))
        _add_body(builder, scene)
        radius = float(scene["strand_radius"])
        cfg = newton.ModelBuilder.ShapeConfig(density=float(scene["linear_density"]) / (np.pi * radius**2), mu=FRICTION)
        for strand in scene["strands"]:
            rod = newton.Rod(
                points=strand,
                radius=radius,
                stretch_rigidity=STRETCH_RIGIDITY,
                shear_rigidity=STRETCH_RIGIDITY,
                bend_rigidity=float(scene["bend_stiffness"]),
                twist_rigidity=float(scene["twist_stiffness"]),
            )
            length = np.linalg.norm(np.diff(strand, axis=0), axis=1).mean()
            damping = DAMPING_SECONDS * float(scene["bend_stiffness"]) / length
            proxies = DiSMechSolver.add_rod(builder, rod, cfg=cfg, bend_damping=damping)
            DiSMechSolver.fix_segment(builder, proxies[0])
        self._shape = scene["strands"].shape
        model = builder.finalize(device="cpu")
        self._solver = DiSMechSolver(model, iterations=ITERATIONS)
        self._state, self._next = model.state(), model.state()

    def step(self, keep: float) -> None:
        self._solver.step(self._state, self._next, None, None, self.time_step)
        self._state, self._next = self._next, self._state
        self._state.dismech.qd.numpy()[:] *= keep  # on the CPU this is a view

    def positions(self) -> np.ndarray:
        return self._state.particle_q.numpy().reshape(self._shape).copy()


def _add_body(builder: newton.ModelBuilder, scene: SceneArrays) -> None:
    # The solver passes over a shape whose bounding sphere is far, and takes the frame's origin for the sphere's centre:
    # with a mesh in world coordinates and the frame at the feet, hair would fall through the head.
    vertices = scene["body_vertices"]
    centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    skin = newton.Mesh(vertices - centre, scene["body_faces"].astype(np.int32).ravel(), compute_inertia=False)
    frame = wp.transform(wp.vec3(*centre.tolist()), wp.quat_identity())
    builder.add_shape_mesh(-1, xform=frame, mesh=skin, cfg=newton.ModelBuilder.ShapeConfig(mu=FRICTION))


if __name__ == "__main__":
    wp.config.quiet = True
    run(Dismech, f"dismech-newton {version('dismech-newton')}, newton {version('newton')}")
