"""What resists the motion of each edge in XPBD: Eqs. 6 and 7, or the rod and Eq. 7, as the kernels read them."""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float as FloatOf

from quaffure.config import HairMaterial
from quaffure.energies.cohesion import Cohesion
from quaffure.energies.hair_energy import HairEnergy
from quaffure.energies.rest_state import RestState
from quaffure.energies.rod_kernels import rod_arrays, rod_energies_and_gradient
from quaffure.energies.rod_term import PosedRod
from quaffure.energies.stretch import stretch_force
from quaffure.energies.stretch_shear import stretch_shear_force
from quaffure.scene import HairScene
from quaffure.solvers.stopping import energy_and_gradient
from quaffure.solvers.xpbd_kernels import LANES

ROD_BOUND = 1.5
"""Stiffness of an edge's spring for the rod, in sums of the bending stiffnesses of its two joints (docs/solvers.md)."""


class EdgeSprings(NamedTuple):
    """What resists the motion of each edge.

    Attributes:
        stiffness: of a spring, whose force is stiffness times the edge less the pull [N/m].
        pull: of that spring [N].
        stretching: stiffness of Eq. 7 [N/m].
    """

    stiffness: FloatOf[np.ndarray, "s e"]
    pull: FloatOf[np.ndarray, "s e 3"]
    stretching: FloatOf[np.ndarray, "s e"]


class EdgeConstants:
    """What the projection of an edge needs: see `sweep_strands`.

    Attributes:
        mass_unit: m_ref, the mean mass [kg].
    """

    def __init__(self, rest: RestState) -> None:
        mass = rest.mass.numpy().astype(np.float64)
        self.mass_unit = float(mass.mean())
        inverse = self.mass_unit / mass
        inverse[:, 0] = 0
        self.inverse_mass = packed(inverse[..., None])[:, :, 0].copy()
        self.coupling = inverse[:, 1:] + inverse[:, :-1]
        self.rest_length = rest.rest_length.numpy().astype(np.float64)

    def at(self, time_step: float, springs: EdgeSprings) -> tuple[FloatOf[np.ndarray, "k e 3 8"], ...]:
        """`edge` and `pull` of `XpbdBlocks` for a time step [s]."""
        scaled = self.coupling * time_step**2 / self.mass_unit
        # The force of Eq. 7 is linear in the length: -k_s l where it is zero.
        stretch_stiffness, _ = stretch_force(1.0, 0.0, springs.stretching)
        stretch_at_zero, _ = stretch_force(0.0, self.rest_length, springs.stretching)
        softness = 1 / (1 + scaled * (springs.stiffness + stretch_stiffness))
        edge = np.stack([self.coupling, -scaled * stretch_at_zero, softness], axis=-1)
        return packed(edge), packed(scaled[..., None] * springs.pull)


class DirectorSprings:
    """Eqs. 6 and 7. The force of Eq. 6 is linear in the edge: -k_c / l d3 where it is zero.

    Attributes:
        depend_on_positions: whether the springs change as the strands move.
    """

    depend_on_positions = False

    def __init__(self, director: FloatOf[np.ndarray, "s e 3"], rest: RestState, material: HairMaterial) -> None:
        inverse = 1 / rest.rest_length.numpy().astype(np.float64)
        stiffness, _ = stretch_shear_force(1.0, 0.0, inverse, material.k_cosserat)
        at_zero, _ = stretch_shear_force(0.0, director.astype(np.float64), inverse[..., None], material.k_cosserat)
        self._springs = EdgeSprings(stiffness, -at_zero, np.full_like(stiffness, material.k_stretch))

    def at(self, x: FloatOf[np.ndarray, "s n 3"]) -> EdgeSprings:
        """The same wherever the strands are."""
        return self._springs


class RodSprings:
    """The force of the rod and of the cohesion of tails on each edge, as that of a spring which gives it where the
    strands are, if the edge is no shorter than at rest; and Eq. 7.

    In edges the rod's Hessian is nearly the block-tridiagonal one of sum B_i / 2 |t_i - t_(i-1)|^2: that is the change
    of the springs' forces until the next search. Along the edge a spring resists stretching, where the rod does not:
    Eq. 7 does the rest. Only edges under a few millimetres have springs stiffer than Eq. 7.
    """

    depend_on_positions = True

    def __init__(self, rod: PosedRod, scene: HairScene, energy: HairEnergy) -> None:
        """
        Args:
            scene: of one sample.
        """
        rest, material = energy.rest, energy.material
        self._rest, self._rotation = rod_arrays(rod.rest, torch.float64), rod.rotation.double()
        bending = self._rest.bending
        beyond = np.pad(bending[:, 1:], ((0, 0), (0, 1)))
        self._length = rest.rest_length.numpy().astype(np.float64)
        self._stiffness = ROD_BOUND * (bending + beyond + self._rest.goal_weight) / self._length**2
        self._stretching = np.maximum(material.k_stretch - self._stiffness, 0.0)
        self._cohesion, self._scene = energy.of_kind(Cohesion), scene
        self._roots = scene.posed[0, :, :1].double()

    def at(self, x: FloatOf[np.ndarray, "s n 3"]) -> EdgeSprings:
        """The springs of strands at these positions [m]."""
        _, gradient = rod_energies_and_gradient(torch.from_numpy(x)[None], self._rest, self._rotation)
        if self._cohesion.terms:
            world = (torch.from_numpy(x) + self._roots).float()[None]
            gradient = gradient + energy_and_gradient(self._cohesion, self._scene, world)[1]
        # An edge moves all vertices beyond it.
        by_edge = gradient[0, :, 1:].flip(1).cumsum(1).flip(1).numpy()
        edges = np.diff(x, axis=1)
        stretched = np.linalg.norm(edges, axis=2).clip(min=1e-12) / self._length
        at_rest_length = edges / stretched[..., None]
        # The rod depends on directions: its force on an edge grows as that shortens. This is the one at rest length.
        by_edge *= np.minimum(stretched, 1.0)[..., None]
        return EdgeSprings(self._stiffness, self._stiffness[..., None] * at_rest_length - by_edge, self._stretching)


def packed(array: FloatOf[np.ndarray, "s n c"]) -> FloatOf[np.ndarray, "k n c 8"]:
    """Strands in blocks of `LANES`, the lane last, float64; the last block is filled up with its last strand."""
    missing = -len(array) % LANES
    filled = np.concatenate([array, np.repeat(array[-1:], missing, axis=0)])
    blocks = filled.reshape(-1, LANES, *array.shape[1:]).transpose(0, 2, 3, 1)
    return np.ascontiguousarray(blocks, dtype=np.float64)


def unpacked(blocks: FloatOf[np.ndarray, "k n c 8"], strands: int) -> FloatOf[np.ndarray, "s n c"]:
    return blocks.transpose(0, 3, 1, 2).reshape(-1, *blocks.shape[1:3])[:strands]
