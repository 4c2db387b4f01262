"""MuJoCo: chains of rigid capsules with its cable plugin, contact against convex hulls of body parts and between hairs.

    env/mujoco/bin/python run_mujoco.py scene.npz --out mujoco.npz

MuJoCo's meshes collide as their convex hulls, so the body is cut into the parts that the joints move; where skin is
hollow, a hull lies outside it. Called by its public interface in its own environment (`set_up.sh mujoco`).
"""

import mujoco
import numpy as np
from peer_run import SceneArrays, run

TIME_STEP = 1 / 480
CM, MG = 1e2, 1e6
"""MuJoCo refuses inertias below 1e-15: in centimetres and milligrams a hair's segments are well above."""
ARMATURE = 1e-11
"""Inertia added to every joint [kg m^2], or the plugin's explicit forces would need steps of 0.1 ms. It has no part in
where hair rests."""
DAMPING = 1e-8
"""Of every joint [N m s]. A third of it does as well; without, curls start to vibrate after 0.2 s and blow up at any
time step: where the bend at rest is large, the plugin's torques are no energy's gradient."""
HULL_VERTICES = 256
CONTACT_SECONDS = 0.01
"""Time constant of contacts; MuJoCo wants two time steps at least."""


class Mujoco:
    """Cables whose first capsule is part of the world."""

    time_step = TIME_STEP

    def __init__(self, scene: SceneArrays) -> None:
        count, vertices, _ = scene["strands"].shape
        self._model = mujoco.MjModel.from_xml_string(_model_text(scene))
        self._data = mujoco.MjData(self._model)
        # The composite writes a body for each segment, root to tip, strand after strand.
        self._bodies = np.arange(self._model.nbody - count * (vertices - 1), self._model.nbody)
        self._shape = count, vertices - 1
        self._last_length = CM * np.linalg.norm(scene["strands"][:, -1] - scene["strands"][:, -2], axis=-1)
        mujoco.mj_forward(self._model, self._data)

    def step(self, keep: float) -> None:
        mujoco.mj_step(self._model, self._data)
        if self._data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number:
            raise ArithmeticError("MuJoCo diverged and restarted")  # it continues without a message
        self._data.qvel[:] *= keep

    def positions(self) -> np.ndarray:
        mujoco.mj_kinematics(self._model, self._data)
        starts = self._data.xpos[self._bodies].reshape(*self._shape, 3)
        along = self._data.xmat[self._bodies].reshape(*self._shape, 3, 3)[:, -1, :, 0]
        tips = starts[:, -1] + self._last_length[:, None] * along
        return np.concatenate([starts, tips[:, None]], axis=1) / CM


def _model_text(scene: SceneArrays) -> str:
    parts = _parts_within_reach(scene)
    meshes = "".join(
        f'<mesh name="part{index}" maxhullvert="{HULL_VERTICES}" inertia="convex" vertex="{_numbers(CM * part)}"/>'
        for index, part in enumerate(parts)
    )
    hulls = "".join(f'<geom type="mesh" mesh="part{index}"/>' for index in range(len(parts)))
    cables = "".join(_cable(index, strand, scene) for index, strand in enumerate(scene["strands"]))
    return f"""<mujoco>
  <option timestep="{TIME_STEP}" gravity="0 0 {-CM * scene["gravity"]}" integrator="implicitfast" solver="CG"/>
  <size memory="1G"/>
  <extension><plugin plugin="mujoco.elasticity.cable"/></extension>
  <default><geom condim="1" solref="{CONTACT_SECONDS} 1"/></default>
  <asset>{meshes}</asset>
  <worldbody>{hulls}{cables}</worldbody>
</mujoco>"""


def _parts_within_reach(scene: SceneArrays) -> list[np.ndarray]:
    """Vertices of the body's parts that the longest strand could touch [m]."""
    roots, vertices, parts = scene["strands"][:, 0], scene["body_vertices"], scene["body_parts"]
    reach = np.linalg.norm(np.diff(scene["strands"], axis=1), axis=-1).sum(axis=1).max()
    low, high = roots.min(axis=0) - reach, roots.max(axis=0) + reach
    near = ((vertices > low) & (vertices < high)).all(axis=1)
    return [vertices[parts == part] for part in np.unique(parts[near])]


def _cable(index: int, strand: np.ndarray, scene: SceneArrays) -> str:
    radius = CM * float(scene["strand_radius"])
    length = CM * np.linalg.norm(np.diff(strand, axis=0), axis=1).mean()
    # Capsules overlap by their round ends, which would weigh too.
    volume = np.pi * radius**2 * length + 4 / 3 * np.pi * radius**3
    density = MG / CM * float(scene["linear_density"]) * length / volume
    second_moment = np.pi * radius**4 / 4
    units = MG * CM**2
    bend = CM * units * float(scene["bend_stiffness"]) / second_moment
    twist = CM * units * float(scene["twist_stiffness"]) / (2 * second_moment)
    return f"""<composite prefix="s{index}_" type="cable" initial="none" vertex="{_numbers(CM * strand)}">
  <plugin plugin="mujoco.elasticity.cable">
    <config key="bend" value="{bend:.9g}"/><config key="twist" value="{twist:.9g}"/><config key="flat" value="false"/>
  </plugin>
  <joint kind="main" damping="{units * DAMPING:.9g}" armature="{units * ARMATURE:.9g}"/>
  <geom type="capsule" size="{radius:.9g}" density="{density:.9g}"/>
</composite>"""


def _numbers(array: np.ndarray) -> str:
    return " ".join(f"{number:.7g}" for number in np.ravel(array))


if __name__ == "__main__":
    run(Mujoco, f"MuJoCo {mujoco.__version__}")
