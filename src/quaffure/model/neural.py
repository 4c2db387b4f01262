"""The network's drape: one pass, no iterations."""

from collections.abc import Iterator, Sequence
from copy import copy
from typing import Any, Protocol, cast, runtime_checkable
from weakref import WeakKeyDictionary

import torch
from torch import nn

from quaffure.backend import Backend, choose_backend
from quaffure.body.body_model import BodyModel
from quaffure.config import HairMaterial
from quaffure.energies.loading import STANDARD_LOADING, Loading
from quaffure.errors import InputError
from quaffure.hair.groom import Groom
from quaffure.hair.groom_cache import GroomCache
from quaffure.model.cpu_backend import CpuBackend, CpuTrainingBackend
from quaffure.model.prepared_groom import PreparedGroom, prepare_groom
from quaffure.model.quaffure_network import DirectionNetwork, QuaffureNetwork
from quaffure.model.torch_backend import DisplacementBackend, TorchBackend
from quaffure.scene import BodyBatch, Scene, check_gradient
from quaffure.types import Positions, Tensor


@runtime_checkable
class DrapeBackend(Protocol):
    """The five steps of a drape on one kind of device.

    Attributes:
        network_seconds: wall time of the network alone, of all drapes so far.
    """

    network_seconds: float

    def posed(self, grooms: Sequence[PreparedGroom], bodies: BodyBatch) -> Iterator[tuple[PreparedGroom, Any]]: ...
    def initial_shape(self, groom: PreparedGroom, posed: Any) -> Any: ...
    def network(self, groom: PreparedGroom, posed: Any, shape: Any) -> Tensor: ...
    def integrate(self, groom: PreparedGroom, posed: Any, shape: Any, changes: Tensor) -> Positions: ...
    def project(self, groom: PreparedGroom, posed: Any, hair: Positions) -> Positions: ...


def drape(backend: DrapeBackend, grooms: Sequence[PreparedGroom], bodies: BodyBatch) -> Iterator[Positions]:
    """Hair [m, world] of each groom on the body of its row: posed, initial shape, network, integrate, project.

    Args:
        grooms: one for each body.

    Returns:
        The rows in order, as many at a time as the backend drapes at once.
    """
    for groom, posed in backend.posed(grooms, bodies):
        shape = backend.initial_shape(groom, posed)
        changes = backend.network(groom, posed, shape)
        hair = backend.integrate(groom, posed, shape, changes)
        yield backend.project(groom, posed, hair)


class NeuralDraper:
    """hair = posed + deformation, the deformation from a network.

    Where contact is resolved before the network, `drape` projects hair out of the skin after it; the paper's
    configuration does not.

    Attributes:
        network: either configuration. Its weights and layers may change between drapes, but weights not in place
            without autograd's knowledge (`.data`), which nobody notices.
        material: the one that the network was trained for.
        loading: stiffness, gravity and wind; may be changed from one drape to the next.
        bf16: run the network's layers in bfloat16; all geometry stays in float32.
    """

    name = "neural"

    def __init__(
        self,
        network: QuaffureNetwork,
        material: HairMaterial,
        bf16: bool = False,
        backend: Backend | None = None,
    ) -> None:
        """
        Args:
            backend: `TORCH` for derivatives in pose, shape and stiffness on the CPU; by default the one of the weights.
        """
        self.network, self.material, self.bf16, self.loading = network, material, bf16, STANDARD_LOADING
        self._kind = backend or choose_backend(next(network.parameters()))
        self._prepared: GroomCache[WeakKeyDictionary[BodyModel, PreparedGroom]] = GroomCache()
        self._stiffened: WeakKeyDictionary[PreparedGroom, tuple[Tensor, int, PreparedGroom]] = WeakKeyDictionary()
        self._made: tuple[object, DrapeBackend] | None = None
        self._encoder_weights: list[int] = []

    def with_loading(self, loading: Loading) -> "NeuralDraper":
        """The same network under another loading; grooms that were prepared stay so.

        Raises:
            InputError: what no hair has (`Loading.check`), or the paper's configuration, which knows one loading.
        """
        loading.check()
        if not self.reads_loading and loading != STANDARD_LOADING:
            raise InputError("stiffness, gravity and wind", "a network of directions", "the paper's configuration")
        other = copy(self)
        other.loading, other._made = loading, None
        return other

    @property
    def reads_loading(self) -> bool:
        """Whether stiffness, gravity and wind are inputs: the paper's configuration knows human hair under gravity."""
        return self.network.config.predicts_directions

    def drape(self, scene: Scene) -> Positions:
        """Draped vertices of every sample [m, world], without gradient."""
        backend = self.backend()  # before: with other weights what was prepared is forgotten
        prepared = [self.prepared(scene.groom, scene.bodies.body)] * len(scene.bodies.body_pose)
        with torch.no_grad():
            hair = list(drape(backend, prepared, scene.bodies))
        return hair[0] if len(hair) == 1 else torch.cat(hair)

    def drape_grooms(self, grooms: Sequence[Groom], bodies: BodyBatch) -> list[Positions]:
        """Each groom draped on the body of its row [m, world], without gradient; the rows in order."""
        backend = self.backend()
        prepared = [self.prepared(groom, bodies.body) for groom in grooms]
        with torch.no_grad():
            return list(drape(backend, prepared, bodies))

    def deform(self, scene: Scene, projects: bool = False) -> Positions:
        """Vertices [m, world], differentiable in the network's weights.

        Args:
            projects: project hair out of the skin as `drape` does; trainings do.

        By the backend `TORCH` differentiable in pose, shape and the stiffness of each edge too, not in the
        encoder's weights.

        Raises:
            ValueError: the scene was posed without the gradient that its pose or shape requires.
        """
        check_gradient(scene)
        kind: type[TorchBackend] = CpuTrainingBackend if self._kind is Backend.CPU else TorchBackend
        prepared = [self.prepared(scene.groom, scene.bodies.body)] * len(scene.bodies.body_pose)
        return torch.cat(list(drape(self._torch_backend(kind, projects), prepared, scene.bodies)))

    def prepared(self, groom: Groom, body: BodyModel) -> PreparedGroom:
        """A groom on a body; kept as long as both are and no array of the groom is changed.

        Raises:
            InputError: the groom is not laid out for the network, or a root is not on the scalp.
        """
        on_bodies = self._prepared.of(groom, WeakKeyDictionary)
        if body not in on_bodies:
            on_bodies[body] = prepare_groom(groom, body, self.network.encoder, self.network.config, self.material)
        prepared, stiffness = on_bodies[body], self.loading.stiffness
        if not isinstance(stiffness, Tensor):
            return prepared
        if stiffness.requires_grad:
            return prepared.stiffened(stiffness)  # not kept: its graph serves one gradient
        kept, version = self._stiffened.get(prepared), stiffness._version
        if kept is None or kept[0] is not stiffness or kept[1] != version:
            kept = self._stiffened[prepared] = stiffness, version, prepared.stiffened(stiffness)
        return kept[2]

    def backend(self) -> DrapeBackend:
        """The five steps with the weights of now; made anew when anything that decides a drape has changed."""
        # Every layer and the version of every weight; `parameters()` takes longer than posing the body.
        layers: list[nn.Module] = [self.network]
        weights: list[object] = []
        for layer in layers:
            for part in layer._modules.values():
                if part is not None:
                    layers.append(part)  # and visited in its turn
            for weight in layer._parameters.values():
                if weight is not None:
                    weights += (weight.data_ptr(), None if weight.is_inference() else weight._version)
        state = (layers, weights, self.loading, self.bf16)
        if self._made is None or self._made[0] != state:
            encoder = [weight.data_ptr() for weight in self.network.encoder.parameters()]
            encoder += [weight._version for weight in self.network.encoder.parameters() if not weight.is_inference()]
            if self._made is not None and encoder != self._encoder_weights:
                self._prepared = GroomCache()  # codes of grooms among it
            self._encoder_weights = encoder
            if self._kind is Backend.CPU and self.network.config.predicts_directions:
                network = cast(DirectionNetwork, self.network)
                made: DrapeBackend = CpuBackend(network, self.loading, self.bf16)
            else:
                made = self._torch_backend(TorchBackend, projects=True)
            self._made = state, made
        return self._made[1]

    def _torch_backend(self, kind: type[TorchBackend], projects: bool) -> TorchBackend:
        if self.network.config.predicts_directions:
            return kind(self.network, self.loading, self.bf16, projects)
        return DisplacementBackend(self.network, self.loading, self.bf16)
