"""Newton's method for one strand in float64: settles any energy to rounding, so that what is left is the model's error.

For validation alone. It takes any differentiable energy whose terms reach a few vertices along the strand, and finds
the banded Hessian from as many Hessian-vector products as the band is wide.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from scipy.linalg import LinAlgError, solveh_banded

from benchmarks.rods.elastic_potentials import Unknowns
from quaffure.types import Energy, Float, Positions, Tensor

Potential = Callable[[Positions, Unknowns], Energy]
Blocks = Float[Tensor, "e c"]


@dataclass(frozen=True)
class Settled:
    """A strand at rest.

    Attributes:
        positions: of its vertices [m].
        unknowns: of its edges (`ElasticPotential.unknowns`).
        energy: [J].
        residual: largest component of the gradient [J], with positions in units of an edge's length.
        iterations: Hessians that were solved with.
    """

    positions: Float[Tensor, "n 3"]
    unknowns: Float[Tensor, "e u"]
    energy: float
    residual: float
    iterations: int


class _Strand:
    """One strand's energy by blocks: vertex i + 1, in units of an edge's length, beside edge i's unknowns."""

    def __init__(self, potential: Potential, root: Float[Tensor, "3"], unit: float, reach: int) -> None:
        self.potential, self.root, self.unit, self.reach = potential, root, unit, reach

    def unpack(self, blocks: Float[Tensor, "b e c"]) -> tuple[Tensor, Tensor]:
        free = self.unit * blocks[:, None, :, :3]
        root = self.root.expand(len(blocks), 1, 1, 3)
        return torch.cat([root, free], dim=2), blocks[:, None, :, 3:]

    def energies(self, blocks: Float[Tensor, "b e c"]) -> Energy:
        return self.potential(*self.unpack(blocks))

    def energy(self, blocks: Blocks) -> float:
        with torch.no_grad():
            return float(self.energies(blocks[None])[0])

    def moved(self, blocks: Blocks, step: Blocks) -> Blocks:
        return _moved(blocks, step, self.root / self.unit)

    def gradient_and_hessian(self, blocks: Blocks) -> tuple[np.ndarray, np.ndarray]:
        """Gradient, and the lower diagonals of the Hessian as `scipy.linalg.solveh_banded` takes them.

        Blocks further apart than `reach` do not meet in any term, so one product with a vector that is one in every
        (2 reach + 1)th block yields those columns of all of them at once.
        """
        count, width = blocks.shape
        stride = 2 * self.reach + 1
        vectors = torch.zeros(stride, width, count, width, dtype=blocks.dtype)
        for offset in range(stride):
            for component in range(width):
                vectors[offset, component, offset::stride, component] = 1
        vectors = vectors.flatten(0, 1)
        copies = blocks.expand(len(vectors), -1, -1).clone().requires_grad_()
        (gradient,) = torch.autograd.grad(self.energies(copies).sum(), copies, create_graph=True)
        (products,) = torch.autograd.grad((gradient * vectors).sum(), copies)
        return gradient[0].detach().flatten().numpy(), self._band(products.detach().numpy())

    def _band(self, products: np.ndarray) -> np.ndarray:
        _, count, width = products.shape
        size = count * width
        row, below = np.meshgrid(np.arange(size), np.arange((self.reach + 1) * width), indexing="ij")
        column = row - below
        block, component = np.divmod(np.maximum(column, 0), width)
        inside = (column >= 0) & (row // width - block <= self.reach)
        colour = (block % (2 * self.reach + 1)) * width + component
        values = products[colour, row // width, row % width]
        band = np.zeros((below.shape[1], size))
        band[below[inside], column[inside]] = values[inside]
        return band


def settle(
    potential: Potential,
    positions: Float[Tensor, "n 3"],
    unknowns: Float[Tensor, "e u"],
    reach: int = 1,
    tolerance: float = 1e-15,
    most_iterations: int = 1000,
) -> Settled:
    """The minimum of `potential` downhill of a start, the root held.

    Newton's method with a shift of the Hessian that grows until a step goes downhill and shrinks while steps do.

    Args:
        potential: total energy [J] of batches of one strand, in float64.
        positions, unknowns: where to start [m].
        reach: furthest edges along the strand that meet in one term: 1 for rods, 3 for torsion springs.
        tolerance: largest component of the gradient to stop at (`Settled.residual`) [J]; an edge of a hair that is a
            centimetre long takes 8e-9 J to lift by its length.

    Raises:
        ArithmeticError: not there after `most_iterations`.
    """
    unit = float(positions.diff(dim=0).norm(dim=-1).mean())
    strand = _Strand(potential, positions[0], unit, reach)
    blocks = torch.cat([positions[1:] / unit, unknowns], dim=-1).double()
    energy, shift, residual = strand.energy(blocks), None, np.inf
    for iteration in range(most_iterations):
        gradient, band = strand.gradient_and_hessian(blocks)
        residual = float(np.abs(gradient).max())
        if residual <= tolerance:
            vertices, edge_unknowns = strand.unpack(blocks[None])
            return Settled(vertices[0, 0], edge_unknowns[0, 0], energy, residual, iteration)
        shift = 1e-3 * float(band[0].max()) if shift is None else shift
        blocks, energy, shift = _step_downhill(strand, blocks, energy, gradient, band, shift)
    raise ArithmeticError(f"no rest after {most_iterations} steps: gradient {residual:.2g} J of {tolerance:.2g} J")


def _step_downhill(
    strand: _Strand, blocks: Blocks, energy: float, gradient: np.ndarray, band: np.ndarray, shift: float
) -> tuple[Blocks, float, float]:
    """The next blocks and their energy, and the shift [J] to begin the next step with."""
    rounding = 1e-14 * abs(energy)
    while shift < 1e12 * band[0].max():
        try:
            step = solveh_banded(np.concatenate([band[:1] + shift, band[1:]]), -gradient, lower=True)
        except LinAlgError:
            shift *= 4
            continue
        candidate = strand.moved(blocks, torch.from_numpy(step).view_as(blocks))
        reached = strand.energy(candidate)
        if reached <= energy + rounding:
            return candidate, reached, shift / 5
        shift *= 4
    raise ArithmeticError("no step goes downhill")


def _moved(blocks: Blocks, step: Blocks, root: Float[Tensor, "3"]) -> Blocks:
    """Blocks after a step that turns edges and quaternions as far as it goes, instead of moving them along lines.

    Along a line, a turn by the angle a lengthens an edge by its a^2 / 2, which it strongly resists: the method would
    creep along a curved valley. To first order the two are equal.
    """
    points = torch.cat([root[None], blocks[:, :3]])
    edges = _turned(points.diff(dim=0), torch.nn.functional.pad(step[:, :3], (0, 0, 1, 0)).diff(dim=0))
    return torch.cat([root + edges.cumsum(0), _turned(blocks[:, 3:], step[:, 3:])], dim=-1)


def _turned(vectors: Float[Tensor, "e d"], change: Float[Tensor, "e d"]) -> Float[Tensor, "e d"]:
    """`vectors` + `change`, but of the length that the change along the vector gives them."""
    length = vectors.norm(dim=-1, keepdim=True)
    along = (change * vectors).sum(-1, keepdim=True) / length
    return (length + along) * torch.nn.functional.normalize(vectors + change, dim=-1)
