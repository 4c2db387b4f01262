"""The elastic models against theory: the numbers of `docs/validation.md` and of its tests.

Every strand here is a real hair (`HeavyRod`), alone, its root clamped at the origin, in float64.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.optimize import minimize_scalar

from benchmarks.rods.closed_form import equilibrium_edges
from benchmarks.rods.elastic_potentials import ElasticModel, Unknowns, cosserat, modified_cosserat
from benchmarks.rods.heavy_rod import REAL_HAIR_WEIGHT, HeavyRod
from benchmarks.rods.rod_newton import Settled, settle
from quaffure.config import STANDARD_GRAVITY, HairMaterial
from quaffure.energies import RodStiffness, energy_body_collision, energy_gravity
from quaffure.geometry import cross_product_matrix, directors
from quaffure.types import Energy, Float, Positions, RestLengths, Tensor

Strand = Float[Tensor, "n 3"]
Distance = Callable[[Positions], Float[Tensor, "b s n"]]
INEXTENSIBLE = RodStiffness(stretch_shear=1.0, k_unit_quaternion=1.0)
"""A real hair's EI and GJ, stretched by less than 3e-5 by its weight, as the boundary-value problem assumes none."""


@dataclass(frozen=True)
class Curl:
    """A right-handed helix.

    Attributes:
        radius, pitch: [m].
    """

    radius: float = 0.008
    pitch: float = 0.05

    @property
    def turn_rate(self) -> float:
        """Angle about the axis per length of the strand [rad/m]."""
        return 2 * math.pi / math.hypot(2 * math.pi * self.radius, self.pitch)

    @property
    def rise(self) -> float:
        """Way along the axis per length of the strand: the sine of the helix's angle."""
        return self.pitch * self.turn_rate / (2 * math.pi)

    @property
    def axes(self) -> np.ndarray:
        """Normal, binormal and tangent at the root in columns, the helix's axis along x."""
        tangent = np.array([self.rise, 0.0, -self.radius * self.turn_rate])
        normal = np.array([0.0, 1.0, 0.0])
        return np.stack([normal, np.cross(tangent, normal), tangent], axis=1)


@dataclass(frozen=True)
class Case:
    """A strand at rest and where it points.

    Attributes:
        length: [m].
        elevation: of the strand, or of its helix's axis, above the x axis [deg]; -90 hangs.
        curl: None if straight.
    """

    length: float
    elevation: float = 0.0
    curl: Curl | None = None

    @property
    def _rotation(self) -> np.ndarray:
        angle = math.radians(self.elevation)
        c, s = math.cos(angle), math.sin(angle)
        return np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])

    def strand(self, vertices: int) -> Strand:
        """Vertices at equal distances along the rest curve, chords between them."""
        s = self.arc_length(vertices)
        points = np.stack([s, 0 * s, 0 * s], axis=1)
        if self.curl is not None:
            angle, radius = self.curl.turn_rate * s, self.curl.radius
            points = np.stack([self.curl.rise * s, radius * (1 - np.cos(angle)), -radius * np.sin(angle)], axis=1)
        return torch.from_numpy(points @ self._rotation.T)

    def rod(self) -> HeavyRod:
        """The same curve as a continuous rod."""
        if self.curl is None:
            return HeavyRod(self.length, clamp=_columns(self._rotation @ np.array(HeavyRod(1.0).clamp)))
        rate, curl = self.curl.turn_rate, self.curl
        curvature = (0.0, curl.radius * rate**2, curl.rise * rate)
        return HeavyRod(self.length, clamp=_columns(self._rotation @ curl.axes), rest_curvature=curvature)

    def true_shape(self, vertices: int) -> np.ndarray:
        """Where the heavy rod takes the vertices [m]."""
        return self.rod().shape(self.arc_length(vertices))

    def arc_length(self, vertices: int) -> np.ndarray:
        return np.linspace(0, self.length, vertices)


def _columns(matrix: np.ndarray) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in matrix.tolist())


def lumped_mass(rest_length: RestLengths, weight: float = REAL_HAIR_WEIGHT) -> Float[Tensor, "s n"]:
    """Mass of every vertex [kg]: half of each edge beside it; `weight` per length [N/m]."""
    half = 0.5 * weight / STANDARD_GRAVITY * rest_length
    return torch.nn.functional.pad(half, (0, 1)) + torch.nn.functional.pad(half, (1, 0))


def settle_under_weight(model: ElasticModel, strand: Strand, reach: int = 1, start: Settled | None = None) -> Settled:
    """A strand of any elastic model at rest under its own weight."""
    posed = strand[None, None]
    rest_length = posed[0].diff(dim=1).norm(dim=-1)
    mass, state = lumped_mass(rest_length), model(posed, rest_length)

    def potential(positions: Positions, unknowns: Unknowns) -> Energy:
        return state.energy(positions, unknowns) + energy_gravity(positions, mass)

    if start is None:
        return settle(potential, strand, state.unknowns[0, 0], reach)
    return settle(potential, start.positions, start.unknowns, reach)


def settle_rod(strand: Strand, stiffness: RodStiffness = INEXTENSIBLE) -> Settled:
    """The full Cosserat rod at rest under its own weight; a soft one first, which is quick, then as stiff as asked."""
    softer = [replace(stiffness, stretch_shear=stiffness.stretch_shear * part) for part in (1e-3, 3e-2)]
    settled: Settled | None = None
    for step in (*softer, stiffness):
        settled = settle_under_weight(cosserat(step), strand, start=settled)
    assert settled is not None
    return settled


def distances_mm(strand: Strand | np.ndarray, other: Strand | np.ndarray) -> np.ndarray:
    """Distance of each vertex from its counterpart [mm]."""
    return 1000 * np.linalg.norm(np.asarray(strand) - np.asarray(other), axis=1)


def rms_mm(strand: Strand | np.ndarray, other: Strand | np.ndarray) -> float:
    """Root of the mean squared distance of vertices from their counterparts, the root left out [mm]."""
    return float(np.sqrt((distances_mm(strand, other)[1:] ** 2).mean()))


def rod_errors(case: Case, vertices: int) -> tuple[float, float]:
    """Error of the full Cosserat rod against the boundary-value problem [mm]: at the tip, and the largest."""
    error = distances_mm(settle_rod(case.strand(vertices)).positions, case.true_shape(vertices))
    return float(error[-1]), float(error.max())


def helix_compliance(vertices: int, length: float = 0.25, curl: Curl | None = None) -> tuple[float, float]:
    """How far a helix stretches under a small force along its axis, per force [m/N]: the rod's, and theory's.

    The force acts on a rigid lever from the tip to the axis. All along, its moment is F radius: twisting by its share
    cos(angle) along the tangent, bending by sin(angle) across. Castigliano: radius^2 length (cos^2/GJ + sin^2/EI). No
    pair bends the last half edge, so its length does not count.
    """
    curl = curl or Curl()
    strand = Case(length, curl=curl).strand(vertices)
    posed, rest_length = strand[None, None], strand[None].diff(dim=1).norm(dim=-1)
    state = cosserat(INEXTENSIBLE)(posed, rest_length)
    axis = strand.new_tensor([1.0, 0.0, 0.0])
    to_axis = strand.new_tensor([0.0, curl.radius, 0.0]) - strand[-1] + axis * strand[-1, 0]
    lever = matrix_from_quaternion(state.unknowns[0, 0, -1]).mT @ to_axis
    force = 1e-8  # N: stretches the helix by a ten thousandth

    def potential(positions: Positions, unknowns: Unknowns) -> Energy:
        held = positions[:, 0, -1] + matrix_from_quaternion(unknowns[:, 0, -1]) @ lever
        return state.energy(positions, unknowns) - force * (held @ axis)

    settled = settle(potential, strand, state.unknowns[0, 0])
    held = settled.positions[-1] + matrix_from_quaternion(settled.unknowns[-1]) @ lever
    sine, covered = curl.rise, length * (1 - 0.5 / (vertices - 1))
    theory = curl.radius**2 * covered * ((1 - sine**2) / INEXTENSIBLE.twist + sine**2 / INEXTENSIBLE.bend)
    return float(held @ axis - strand[-1, 0]) / force, theory


def matrix_from_quaternion(quaternion: Float[Tensor, "*batch 4"]) -> Float[Tensor, "*batch 3 3"]:
    """Rotation matrices of quaternions `wxyz` of any non-zero length."""
    unit = torch.nn.functional.normalize(quaternion, dim=-1)
    scalar, cross = unit[..., 0, None, None], cross_product_matrix(unit[..., 1:])
    identity = torch.eye(3, dtype=unit.dtype, device=unit.device)
    return identity + 2 * (scalar * cross + cross @ cross)


def sagged_strand(strand: Strand, material: HairMaterial) -> Strand:
    """The modified energy's exact rest under weight, from the closed form [m]."""
    rest_length = strand[None].diff(dim=1).norm(dim=-1)
    mass_beyond = lumped_mass(rest_length)[:, 1:].flip(1).cumsum(1).flip(1)
    director = directors(strand[None, None])
    edges = equilibrium_edges(director, rest_length, mass_beyond, material.k_cosserat, material.k_stretch)[0, 0]
    return torch.cat([strand[:1], strand[0] + edges.cumsum(0)])


def closed_form_difference_mm(case: Case, vertices: int, material: HairMaterial) -> float:
    """Largest distance between the modified energy's minimum as Newton's method finds it and the closed form [mm]."""
    settled = settle_under_weight(modified_cosserat(material), case.strand(vertices))
    return float(distances_mm(settled.positions, sagged_strand(case.strand(vertices), material)).max())


def modified_error_mm(case: Case, k_cosserat: float, vertices: int, true_shape: np.ndarray) -> float:
    """How far the modified energy's strand is from the true rod, root mean square [mm]."""
    material = HairMaterial(k_cosserat=k_cosserat)
    return rms_mm(sagged_strand(case.strand(vertices), material), true_shape)


def best_k_cosserat(cases: list[Case], vertices: int, true_shapes: list[np.ndarray]) -> float:
    """k_Cosserat [J] of least mean error, each case's in shares of its strand's length."""

    def mean_error(exponent: float) -> float:
        errors = [modified_error_mm(c, 10**exponent, vertices, t) / c.length for c, t in zip(cases, true_shapes)]
        return float(np.mean(errors))

    coarse = np.linspace(-9.5, -6, 36)
    nearest = float(coarse[np.argmin([mean_error(e) for e in coarse])])
    found = minimize_scalar(mean_error, bounds=(nearest - 0.1, nearest + 0.1), method="bounded")
    return float(10**found.x)


def resting_depth(k_body_collision: float, weight: float) -> float:
    """How deep in the margin a vertex lies whose weight [N] the body carries alone: 3 k (D - d)^2 = weight [m]."""
    return math.sqrt(weight / (3 * k_body_collision))


def above_plane(positions: Positions) -> Float[Tensor, "b s n"]:
    """Signed distance [m] to the plane z = 0."""
    return positions[..., 2]


@dataclass(frozen=True)
class Sphere:
    """Signed distance [m] to a sphere of `radius` [m] round `centre` [m]."""

    centre: tuple[float, float, float]
    radius: float

    def __call__(self, positions: Positions) -> Float[Tensor, "b s n"]:
        return (positions - positions.new_tensor(self.centre)).norm(dim=-1) - self.radius


def settle_in_contact(model: ElasticModel, strand: Strand, distance: Distance, material: HairMaterial) -> Settled:
    """A strand at rest under its weight and in contact (Eq. 10) with a body of known distance; the root feels none."""
    posed, rest_length = strand[None, None], strand[None].diff(dim=1).norm(dim=-1)
    state, mass = model(posed, rest_length), lumped_mass(rest_length)
    margin = torch.full_like(mass, material.collision_margin)
    margin[:, 0] = -1.0

    def potential(positions: Positions, unknowns: Unknowns) -> Energy:
        contact = energy_body_collision(distance(positions), margin, material.k_body_collision)
        return state.energy(positions, unknowns) + energy_gravity(positions, mass) + contact

    return settle(potential, strand, state.unknowns[0, 0])


def depths_in_margin(strand: Strand, distance: Distance, material: HairMaterial) -> Float[Tensor, " n"]:
    """D - d of every vertex but the root [m], for the modified energy; negative where a vertex does not touch."""
    settled = settle_in_contact(modified_cosserat(material), strand, distance, material)
    return material.collision_margin - distance(settled.positions[None, None])[0, 0, 1:]


def stretch_percent(length: float, vertices: int, material: HairMaterial) -> tuple[float, float]:
    """Largest stretch of an edge of a hanging strand, and of the strand as a whole [%]."""
    strand = Case(length, elevation=-90.0).strand(vertices)
    rest, hung = (x.diff(dim=0).norm(dim=-1) for x in (strand, sagged_strand(strand, material)))
    return 100 * float((hung / rest - 1).max()), 100 * float(hung.sum() / rest.sum() - 1)
