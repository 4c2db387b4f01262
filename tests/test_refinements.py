"""Strand layers that read where hair is after the changes so far: the same drape by every backend and layout."""

from dataclasses import replace

import pytest
import torch

from quaffure import HairMaterial
from quaffure.backend import Backend
from quaffure.body import FEATURE_COUNT, BodyModel
from quaffure.geometry import integrate_directions
from quaffure.model import (
    DirectionNetwork,
    ForwardNetwork,
    InferenceNetwork,
    NetworkConfig,
    NetworkInputs,
    NeuralDraper,
)
from quaffure.model.cpu_backend import CpuTrainingBackend
from quaffure.model.strand_layers import OWN_FEATURES
from quaffure.model.surroundings import surroundings_reference
from quaffure.model.torch_backend import TorchBackend
from quaffure.scene import Scene
from quaffure.types import Tensor
from tests.scenes import random_bodies
from tests.training_runs import perturbed, tiny_groom

CONFIG = NetworkConfig(pose_features=FEATURE_COUNT, texel_channels=8, strand_width=16, surroundings=True, refinements=2)
MATERIAL = HairMaterial()


class Recording(DirectionNetwork):
    """Keeps what its refinements read."""

    def forward(self, inputs: NetworkInputs, features: Tensor) -> Tensor:
        self.read: list[tuple[Tensor, Tensor]] = []

        def recorded(changes: Tensor) -> Tensor:
            self.read.append((changes.detach().clone(), inputs.features_after(changes).detach().clone()))
            return self.read[-1][1]

        return super().forward(replace(inputs, features_after=recorded), features)


class Comparing(DirectionNetwork):
    """Reads its features after those of changed hair, and how all strands move in the mean."""

    def forward(self, inputs: NetworkInputs, features: Tensor) -> Tensor:
        changes = super().forward(inputs, features)
        moved = (inputs.features_after(changes) - features)[..., : changes[0, 0].numel()].view_as(changes)
        return changes + 20 * (moved + moved.mean(dim=1, keepdim=True))


def network_of(kind: type[DirectionNetwork], config: NetworkConfig = CONFIG) -> DirectionNetwork:
    torch.manual_seed(0)
    return perturbed(kind(config))


@pytest.fixture(scope="module")
def scene(body: BodyModel) -> Scene:
    return Scene(tiny_groom(body).select(torch.arange(0, 40, 3)), random_bodies(body, 2))


def test_refinements_move_hair(scene: Scene) -> None:
    once = network_of(DirectionNetwork, replace(CONFIG, refinements=0))
    twice = network_of(DirectionNetwork)
    twice.load_state_dict(twice.state_dict() | once.state_dict())
    moved = NeuralDraper(twice, MATERIAL).drape(scene) - NeuralDraper(once, MATERIAL).drape(scene)
    assert moved.norm(dim=-1).amax() > 0.002
    for layers in twice.refinements:
        for parameter in layers.strand[-1].parameters():
            torch.nn.init.zeros_(parameter)
    hair = NeuralDraper(twice, MATERIAL).drape(scene)
    torch.testing.assert_close(hair, NeuralDraper(once, MATERIAL).drape(scene), atol=0, rtol=0)


@pytest.mark.parametrize("kind", [DirectionNetwork, Recording])
def test_training_and_draping_agree(scene: Scene, kind: type[DirectionNetwork]) -> None:
    network = network_of(kind)
    layout = network.for_inference(bf16=False)
    assert isinstance(layout, InferenceNetwork if kind is DirectionNetwork else ForwardNetwork)
    draper = NeuralDraper(network, MATERIAL)
    with torch.no_grad():
        trained = draper.deform(scene, projects=True)
    assert (draper.drape(scene) - trained).norm(dim=-1).quantile(0.95) < 2e-5


@pytest.mark.parametrize("config", [CONFIG, replace(CONFIG, surroundings=False, refinements=0)])
def test_an_own_forward_sees_what_it_is_trained_on(scene: Scene, config: NetworkConfig) -> None:
    """Each strand once, though kernels have rows that repeat one; and features that stay as they are."""
    network = network_of(Comparing, replace(config, contact=False))
    draper = NeuralDraper(network, MATERIAL)
    with torch.no_grad():
        trained = draper.deform(scene)
    assert len(scene.groom) % 8
    torch.testing.assert_close(draper.drape(scene), trained, atol=2e-5, rtol=0)
    by_torch = NeuralDraper(network, MATERIAL, backend=Backend.TORCH).drape(scene)
    assert (by_torch - trained).norm(dim=-1).quantile(0.95) < 2e-5
    plain = NeuralDraper(network_of(DirectionNetwork, network.config), MATERIAL).drape(scene)
    assert (plain - trained).norm(dim=-1).mean() > 1e-3


def test_both_backends_drape_alike(scene: Scene) -> None:
    network = network_of(DirectionNetwork)
    hair = NeuralDraper(network, MATERIAL, backend=Backend.TORCH).drape(scene)
    assert (NeuralDraper(network, MATERIAL).drape(scene) - hair).norm(dim=-1).quantile(0.95) < 1e-4


def test_bfloat16_moves_vertices_by_little(scene: Scene) -> None:
    network = network_of(DirectionNetwork)
    exact, rounded = (NeuralDraper(network, MATERIAL, bf16).drape(scene) for bf16 in (False, True))
    assert 0 < (exact - rounded).norm(dim=-1).mean() < 1e-3


@pytest.mark.parametrize("backend", [Backend.CPU, Backend.TORCH])
def test_a_refinement_reads_where_hair_is(scene: Scene, backend: Backend) -> None:
    """Rotated, integrated and measured here once more, from the changes that it is given."""
    network = network_of(Recording)
    draper = NeuralDraper(network, MATERIAL, backend=backend)
    draper.deform(scene)
    groom = draper.prepared(scene.groom, scene.bodies.body)
    assert len(network.read) == 2
    kind = CpuTrainingBackend if backend is Backend.CPU else TorchBackend
    steps = kind(network, draper.loading, bf16=False, projects=False)
    (_, posed), *_ = steps.posed([groom] * 2, scene.bodies)
    shape = steps.initial_shape(groom, posed)
    for changes, features in network.read:
        half = 0.5 * shape.compliance[..., None] * changes.float()
        quaternion = torch.nn.functional.pad(half.cumsum(2), (1, 0), value=1.0)
        real, imaginary = torch.nn.functional.normalize(quaternion, dim=-1).split([1, 3], dim=-1)
        twice = 2 * torch.linalg.cross(imaginary, shape.edges)
        edges = shape.edges + real * twice + torch.linalg.cross(imaginary, twice)
        positions = integrate_directions(shape.roots, edges, groom.rest_length)
        around = surroundings_reference(positions, groom.surroundings, CONFIG.density_grid).flatten(2)
        torch.testing.assert_close(features[..., :69], positions[:, :, 1:].flatten(2), atol=2e-6, rtol=0)
        torch.testing.assert_close(features[..., 69:OWN_FEATURES], shape.features[..., 69:OWN_FEATURES])
        torch.testing.assert_close(features[..., OWN_FEATURES:], around, atol=1e-3, rtol=1e-3)
