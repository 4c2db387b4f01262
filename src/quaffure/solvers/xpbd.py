"""Quasi-static XPBD (Macklin, Mueller and Chentanez 2016) of the energies of `HairEnergy`.

Every term is a sum of U(C) over constraints C, and a time step minimizes, from x~ = x_n + dt^2 g with the velocities
reset, m / (2 dt^2) |x - x~|^2 + sum U. Its constraints in XPBD's form U = C^2 / (2 alpha):

    Eq. 6   C = (x1 - x0) / l - d3, a vector       alpha = 1 / k_Cosserat
    Eq. 7   C = |x1 - x0| - l                      alpha = 1 / k_stretch
    Eq. 10  C = sqrt(2 k_bc) max(D - d, 0)^(3/2)   alpha = 1
    Eq. 11  C = sqrt(2 k_sc) max(rho - rho_rest, 0)^(3/2)   alpha = 1

XPBD takes one Newton step per projection and adds up the multipliers times gradients that have turned since; what it
converges to is then not quite the minimum. Here each projection takes its constraint's whole force out, solves for
it exactly and puts it back, which is the same where C is linear:

    an edge, Eqs. 6 and 7 together: without its tension T it is e' = e + W T, W = dt^2 (1/m0 + 1/m1). It points along
        p = e' + W (k_c / l) d3, with the length (|p| + W k_s l) / (1 + W (k_c / l^2 + k_s)); T = (e' - e) / W.
    a contact: the shortfall s' without the force becomes s with s + 3 k_bc (dt^2 / m) s^2 = s', in the tangent plane
        of the signed distance.
    a density: its excess becomes e with e + 3 k_sc G e^2 = e' = e_now + G p, p its pressure and G = dt^2 sum of
        |grad rho|^2 / m, all vertices at once (Jacobi), each taking only a part of the step since many share it. That
        is linear in x, which holds for moves well below the smoothing length; yet a change of pressure moves hair in
        proportion to dt^2, centimetres at dt = 0.03 s. So no pass moves a vertex by more than `MOST_SHIFT`.

So x = x~ + dt^2 / m times the constraint forces holds all the time, those forces are the energy's at convergence, and a
step that moves nothing has found grad E = 0, whatever the masses and time steps.

With the rod in place of Eq. 6 an edge's force depends on its neighbours. It is taken as linear in the edge around the
last search, where it is exact: the force of a spring toward a direction that the next search renews, of a stiffness
that bounds the rod's (`RodSprings`). Converged, it is the rod's; twist is at its equilibrium at every search.

Three choices of our own: multipliers are kept from step to step (a step's minimum is the same; hair need not fall free
first); they start as the tensions that hold the weight; and time steps may shrink. Long ones move whole strands, short
ones, which barely couple the constraints, then settle what they left trembling.
"""

import time
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float as FloatOf
from numba import get_num_threads

from quaffure.config import HairMaterial
from quaffure.draper import StoppingReport
from quaffure.energies.body_collision import contact_force
from quaffure.energies.by_name import ROD
from quaffure.energies.cohesion import Cohesion
from quaffure.energies.energy_term import Terms
from quaffure.energies.fused_density import active_particles, density_gradient, sort_particles
from quaffure.energies.hair_energy import HairEnergy
from quaffure.energies.rest_state import RestState
from quaffure.energies.rod_term import Rod
from quaffure.scene import HairScene
from quaffure.solvers.stopping import stopping_report
from quaffure.solvers.supported_terms import refuse_other_terms
from quaffure.solvers.xpbd_kernels import (
    FAR_AWAY,
    LANES,
    PlaneSearch,
    XpbdBlocks,
    excess_and_mobility,
    find_planes,
    sweep_strands,
)
from quaffure.solvers.xpbd_springs import DirectorSprings, EdgeConstants, RodSprings, packed, unpacked
from quaffure.types import Positions

MOST_PUSH = 0.005
"""How far one projection of a contact moves a vertex at most [m]: deep ones come out over several."""
MOST_SHIFT = 0.3
"""How far one pass over the densities moves a vertex at most [smoothing lengths]."""


@dataclass(frozen=True)
class XpbdSetting:
    """How long and how carefully to iterate.

    Attributes:
        steps: time steps.
        iterations: sweeps over all constraints of a strand in a step, from root to tip and back in turn.
        first_time_step: dt of the first step [s].
        last_time_step: dt of the last; in between they form a geometric series [s].
        refresh: sweeps between two searches for the nearest faces, each with one pass over the densities.
        spring_refresh: sweeps between two linearizations of the rod.
        relaxation: over-relaxation of the edges, 1 to 2.
        density_relaxation: part of its own step that each density takes.
    """

    steps: int = 100
    iterations: int = 20
    first_time_step: float = 0.2
    last_time_step: float = 0.001
    refresh: int = 20
    spring_refresh: int = 5
    relaxation: float = 1.5
    density_relaxation: float = 0.2

    def __post_init__(self) -> None:
        """Raises:
        ValueError: a count below 1, or a time step or a relaxation that is not above 0.
        """
        if min(self.steps, self.iterations, self.refresh, self.spring_refresh) < 1:
            raise ValueError(f"expected 1 or more steps, iterations and sweeps between two searches, found {self}")
        if min(self.first_time_step, self.last_time_step, self.relaxation, self.density_relaxation) <= 0:
            raise ValueError(f"expected time steps and relaxations above 0, found {self}")

    def time_step(self, step: int) -> float:
        """dt of a step [s]."""
        ratio = self.last_time_step / self.first_time_step
        return self.first_time_step * ratio ** (step / max(1, self.steps - 1))


def paper_setting() -> XpbdSetting:
    """Sec. 4.2: 30 steps of 10,000 iterations. Neither the time step nor the rate of searches is printed.

    With steps of one length a dense groom keeps trembling a little; shrinking ones, our own setting, settle it.
    """
    return XpbdSetting(
        steps=30, iterations=10_000, first_time_step=0.03, last_time_step=0.03, relaxation=1.0, density_relaxation=0.1
    )


class XpbdDraper:
    """Settles hair by quasi-static time steps.

    Attributes:
        setting: see `XpbdSetting`; `paper_setting()` is the paper's.
    """

    name = "xpbd"

    def __init__(
        self, material: HairMaterial | None = None, setting: XpbdSetting | None = None, terms: Terms | None = None
    ) -> None:
        """
        Raises:
            InputError: terms other than Eqs. 6, 7, 9, 10 and 11, or instead of Eq. 6 the rod and the cohesion of tails.
        """
        if terms is not None and any(isinstance(term, Rod) for term in terms):
            refuse_other_terms(self.name, terms, ROD, optional=(Cohesion,))
        else:
            refuse_other_terms(self.name, terms)
        self.material = material or HairMaterial()
        self.setting = setting or XpbdSetting()
        self.terms = terms

    def drape(self, scene: HairScene) -> Positions:
        return self.solve(scene)[0]

    def solve(self, scene: HairScene) -> tuple[Positions, StoppingReport]:
        """Draped vertices [m] and where the solver stopped; its iterations are the sweeps of one sample."""
        begin = time.perf_counter()
        energy = HairEnergy(scene.groom, self.material, self.terms)
        draped = torch.empty_like(scene.posed)
        for sample in range(len(draped)):
            hair = HairInMotion(scene.sample(sample), energy)
            for step in range(self.setting.steps):
                hair.step(self.setting.time_step(step), self.setting)
            draped[sample] = torch.from_numpy(hair.world())
        seconds = time.perf_counter() - begin
        sweeps = self.setting.steps * self.setting.iterations
        return draped, stopping_report(energy, scene, draped, sweeps, seconds)


class PaperXpbdDraper(XpbdDraper):
    """`XpbdDraper` with the paper's setting, `paper_setting`."""

    name = "xpbd_paper"

    def __init__(self, material: HairMaterial | None = None, terms: Terms | None = None) -> None:
        """
        Raises:
            InputError: terms other than Eqs. 6, 7, 9, 10 and 11.
        """
        refuse_other_terms(self.name, terms)
        super().__init__(material, paper_setting(), terms)


class HairInMotion:
    """The state of one sample between time steps, strands packed as the kernels want them.

    Multipliers carry the factor dt^2 / m_ref, m_ref the mean mass, which makes metres of them.
    """

    def __init__(self, scene: HairScene, energy: HairEnergy) -> None:
        """
        Args:
            scene: of one sample.
        """
        rest, material = energy.rest, energy.material
        self.material = material
        self.edges = EdgeConstants(rest)
        rod = next((term for term in energy.terms if isinstance(term, Rod)), None)
        self.springs: DirectorSprings | RodSprings = (
            DirectorSprings(scene.director[0].numpy(), rest, material)
            if rod is None
            else RodSprings(rod.prepare(rest, scene), scene, energy)
        )
        posed = scene.posed[0].detach().numpy()
        self.roots = posed[:, 0].copy()
        self.x = packed(posed - self.roots[:, None].astype(np.float64))
        self.before = self.x
        self.time_step = 1.0
        self.tension = packed(
            rest.mass_beyond.numpy()[..., None] / self.edges.mass_unit * np.array(energy.acceleration)
        )
        self.contact = np.zeros_like(self.x)
        self.pushed = np.zeros_like(self.x)
        self.margin, self.surface = rest.collision_margin.numpy(), scene.surface.sample_arrays(0)
        shape = self.margin.shape
        self.last = PlaneSearch(posed.copy(), np.zeros(shape, np.float32), np.zeros(shape, np.int32))
        self.plane = np.zeros((*self.x.shape[:2], 4, LANES))
        self.plane[:, :, 3] = FAR_AWAY
        self.density = DensityConstraints(rest, material)

    def world(self) -> FloatOf[np.ndarray, "s n 3"]:
        """Vertices [m, world]."""
        return (unpacked(self.x, len(self.roots)) + self.roots[:, None]).astype(np.float32, order="C")

    def step(self, time_step: float, setting: XpbdSetting) -> None:
        """One time step of dt [s] from rest."""
        # x~ plus the displacements by all forces known. They moved x, gravity included, by x_n - x_(n-1) in the last
        # step, in proportion to dt^2; before the first, tensions hold the hair where it is.
        growth = (time_step / self.time_step) ** 2
        self.x, self.before, self.time_step = self.x + growth * (self.x - self.before), self.x, time_step
        for multipliers in (self.tension, self.contact, self.pushed):
            multipliers *= growth
        # 3 k_bc: the force of Eq. 10 at a shortfall of one metre.
        force, _ = contact_force(0.0, 1.0, self.material.k_body_collision)
        stiffness = -force * time_step**2 / self.edges.mass_unit
        for done in range(0, setting.iterations, setting.refresh):
            world = self.world()
            find_planes(world, self.roots, self.margin, self.surface, self.last, self.plane)
            if self.material.k_self_collision > 0:
                shift = self.density.push(world, time_step, setting.density_relaxation) - self.pushed
                longest = np.linalg.norm(shift, axis=2, keepdims=True)
                shift *= np.minimum(1.0, MOST_SHIFT * self.material.smoothing_length / np.maximum(longest, 1e-30))
                self.x += shift
                self.pushed += shift
            left = min(setting.refresh, setting.iterations - done)
            while left > 0:
                sweeps = min(left, setting.spring_refresh if self.springs.depend_on_positions else left)
                constants, pull = self.edges.at(time_step, self.springs.at(unpacked(self.x, len(self.roots))))
                blocks = XpbdBlocks(
                    self.x, self.tension, self.contact, self.plane, self.edges.inverse_mass, constants, pull
                )
                sweep_strands(blocks, stiffness, setting.relaxation, MOST_PUSH, sweeps)
                left -= sweeps


class DensityConstraints:
    """The densities of all vertices and their multipliers, the pressures [J m^3/kg]."""

    def __init__(self, rest: RestState, material: HairMaterial) -> None:
        self.strands, self.vertices = rest.mass.shape
        self.mass = rest.mass.flatten().numpy()
        mobile = 1 / rest.mass
        mobile[:, 0] = 0
        self.inverse_mass = mobile.flatten().numpy()
        self.rest_density = rest.rest_density.flatten().numpy()
        self.pressure = np.zeros(len(self.mass), np.float32)
        self.k_self_collision = material.k_self_collision
        self.smoothing_length = np.float32(material.smoothing_length)

    def push(
        self, world: FloatOf[np.ndarray, "s n 3"], time_step: float, relaxation: float
    ) -> FloatOf[np.ndarray, "k n 3 8"]:
        """Project all densities at once; the displacement of every vertex by the pressures that follow [m], packed."""
        flat = world.reshape(-1, 3)
        h = self.smoothing_length
        order, shape, particles = sort_particles(flat, self.mass, np.float32(2) * h)
        mobile = (self.inverse_mass * np.float32(time_step**2))[order]
        excess, mobility = np.empty(len(order), np.float32), np.empty(len(order), np.float32)
        excess_and_mobility(particles, mobile, self.rest_density[order], shape, h, excess, mobility)
        before, gain, stiffness = self.pressure[order], mobility.astype(np.float64), 3 * self.k_self_collision
        free = np.maximum(excess + gain * before, 0)
        left = 2 * free / (1 + np.sqrt(1 + 4 * stiffness * gain * free))
        pressure = (before + relaxation * (stiffness * left**2 - before)).astype(np.float32)
        self.pressure[order] = pressure
        gradient = np.empty_like(flat)
        active = active_particles(particles, pressure)
        density_gradient(particles, active, shape, pressure, order, h, get_num_threads(), gradient)
        moved = -gradient * (self.inverse_mass * np.float32(time_step**2))[:, None]
        return packed(moved.reshape(self.strands, self.vertices, 3))
