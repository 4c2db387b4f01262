"""Newton's step of single strands by elimination against a dense solve."""

import numpy as np
import pytest
import torch

from quaffure.solvers.strand_recursion import LEAST_ALIGNMENT, StrandModel, newton_rotations
from tests.strand_reference import newton_rotations_reference

CONTACT = 10.0  # k_bc [J/m^3]


def _unit(generator: np.random.Generator, *shape: int) -> np.ndarray:
    vectors = generator.standard_normal((*shape, 3))
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _random_model(strands: int, edges: int = 23) -> StrandModel:
    generator = np.random.default_rng(0)
    direction = _unit(generator, strands, 1) + 0.5 * _unit(generator, strands, edges).cumsum(axis=1)
    depth = generator.uniform(0, 0.01, (strands, edges + 1, 1)) * (np.arange(edges + 1) % 3 > 0)[:, None]
    vertices = (strands, edges + 1)
    fields = StrandModel(
        direction=direction / np.linalg.norm(direction, axis=-1, keepdims=True),
        root_direction=_unit(generator, strands),
        length=generator.uniform(5e-3, 15e-3, (strands, edges)),
        bending=generator.uniform(5e-7, 5e-6, (strands, edges)),
        twisting=generator.uniform(5e-7, 5e-6, (strands, edges)),
        goal=np.where(generator.random((strands, edges)) < 0.1, 1e-5, 0.0),
        gradient=1e-6 * generator.standard_normal((*vertices, 3)),
        contact=np.concatenate([_unit(generator, *vertices), depth], axis=-1),
        around_gradient=1e-6 * generator.standard_normal((*vertices, 3)),
        around_stiffness=generator.uniform(0, 1e-2, vertices),
    )
    return StrandModel(*(np.ascontiguousarray(field, np.float32) for field in fields))


@pytest.mark.parametrize("strands", [1, 8, 21])
def test_elimination_solves_the_dense_system(strands: int) -> None:
    model = _random_model(strands)
    rotation = np.full((strands, 23, 3), np.nan, np.float32)
    newton_rotations(model, np.float32(CONTACT), np.arange(strands), rotation)
    expected = newton_rotations_reference(model, CONTACT)
    error = (torch.from_numpy(rotation) - expected).norm(dim=-1) / expected.norm(dim=-1).mean()
    assert float(error.max()) < 1e-4


def test_elimination_solves_the_dense_system_where_an_edge_folds_back() -> None:
    model = _random_model(8)
    folded = 0.05 * _unit(np.random.default_rng(1), 8) - model.direction[:, 4]
    model.direction[:, 5] = folded / np.linalg.norm(folded, axis=-1, keepdims=True)
    assert (1 + (model.direction[:, 4] * model.direction[:, 5]).sum(-1) < LEAST_ALIGNMENT).all()
    rotation = np.empty((8, 23, 3), np.float32)
    newton_rotations(model, np.float32(CONTACT), np.arange(8), rotation)
    expected = newton_rotations_reference(model, CONTACT)
    error = (torch.from_numpy(rotation) - expected).norm(dim=-1) / expected.norm(dim=-1).mean()
    assert float(error.max()) < 1e-4


def test_only_the_strands_listed_are_solved() -> None:
    model = _random_model(12)
    rotation = np.full((12, 23, 3), np.nan, np.float32)
    newton_rotations(model, np.float32(CONTACT), np.array([3, 7]), rotation)
    solved = ~np.isnan(rotation).any(axis=(1, 2))
    assert solved.nonzero()[0].tolist() == [3, 7]
