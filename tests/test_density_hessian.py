"""The Hessian of Eq. 11 against differences of its gradient, and the models between a convex one and it."""

import numpy as np
import pytest

from quaffure.solvers.newton.density_hessian import density_blocks, density_force, density_product
from quaffure.solvers.newton.density_pairs import PressedPairs, pressed_pairs
from quaffure.solvers.newton.density_particles import DensityParticles, density, density_particles


def dense_points() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points that all press on each other, their masses and rest densities."""
    generator = np.random.default_rng(2)
    points, mass = 0.02 * generator.random((60, 3)), 1e-7 * (1 + generator.random(60))
    return points, mass, 0.5 * density(density_particles(points, mass, 5e-3))


def pairs_of(particles: DensityParticles, rest: np.ndarray, exactness: float) -> tuple[PressedPairs, np.ndarray]:
    """The pairs of the sum of cubed excesses, and the derivative by the density."""
    excess = (density(particles) - rest).clip(min=0)
    return pressed_pairs(particles, 3 * excess**2, 6 * excess, exactness), 3 * excess**2


def test_hessian_of_the_densities_matches_differences_of_their_gradient() -> None:
    points, mass, rest = dense_points()
    particles = density_particles(points, mass, 5e-3)

    def gradient(x: np.ndarray) -> np.ndarray:
        # The same order as the undisturbed particles', though a point may have crossed into another cell.
        moved = particles._replace(x=x[:, 0].copy(), y=x[:, 1].copy(), z=x[:, 2].copy())
        return density_force(*pairs_of(moved, rest, 1.0))

    sorted_points = points[particles.order]
    step = np.random.default_rng(3).normal(size=points.shape)
    difference = (gradient(sorted_points + 1e-5 * step) - gradient(sorted_points - 1e-5 * step)) / 2e-5
    product = density_product(pairs_of(particles, rest, 1.0)[0], step)
    # Single precision allows no smaller step.
    assert np.linalg.norm(difference - product) < 3e-3 * np.linalg.norm(product)


@pytest.mark.parametrize("exactness", [0.0, 0.5, 1.0])
def test_blocks_are_those_of_the_whole_hessian(exactness: float) -> None:
    pairs, whole = hessian_of_the_particles(exactness)
    own = np.stack([whole[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] for i in range(60)])
    scale = np.abs(whole).max()
    assert density_blocks(pairs) == pytest.approx(own, rel=1e-4, abs=1e-5 * scale)
    assert np.abs(whole - whole.T).max() < 1e-5 * scale


def test_models_lie_between_a_convex_one_and_the_exact_one() -> None:
    convex, between, exact = (hessian_of_the_particles(exactness)[1] for exactness in (0.0, 0.3, 1.0))
    scale = np.abs(exact).max()
    assert least_curvature(convex) > -1e-5 * scale
    assert least_curvature(exact) < -1e-3 * scale
    assert between == pytest.approx(0.7 * convex + 0.3 * exact, abs=1e-5 * scale)


def hessian_of_the_particles(exactness: float) -> tuple[PressedPairs, np.ndarray]:
    """The pairs, and the matrix of their products."""
    points, mass, rest = dense_points()
    pairs, _ = pairs_of(density_particles(points, mass, 5e-3), rest, exactness)
    columns = [density_product(pairs, one.reshape(60, 3)).ravel() for one in np.eye(180)]
    return pairs, np.stack(columns, axis=1)


def least_curvature(matrix: np.ndarray) -> float:
    return float(np.linalg.eigvalsh(0.5 * (matrix + matrix.T))[0])


@pytest.mark.parametrize("short_of_the_rim", [1e-4, 1e-8, 1e-12, 1e-16])
def test_a_pair_at_the_rim_of_the_kernel_stays_finite(short_of_the_rim: float) -> None:
    """The kernel's own Hessian over its squared gradient grows there like the distance to the power of -3."""
    points = np.array([[0.0, 0, 0], [1e-2 * (1 - short_of_the_rim), 0, 0]])
    pairs = pressed_pairs(density_particles(points, np.ones(2), 5e-3), np.ones(2), np.ones(2))
    assert np.isfinite(pairs.along).all()
    product = density_product(pairs, np.array([[0.0, 0, 0], [1e-3, 0, 0]]))
    assert np.isfinite(product).all()
    assert (np.abs(product).max() > 0) == (short_of_the_rim > 1e-6)
