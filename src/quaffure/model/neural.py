"""The network's drape: one pass, no iterations, and hair out of the skin."""

from collections.abc import Sequence
from weakref import WeakKeyDictionary

import torch

from quaffure.body.body_model import BodyModel
from quaffure.body.head_frame import HeadFrameBody, head_frame_body
from quaffure.config import HairMaterial
from quaffure.geometry.polyline import integrate_directions
from quaffure.hair.groom import Groom
from quaffure.model.compiled_drape import BATCH, CompiledDrape
from quaffure.model.inference_network import InferenceNetwork
from quaffure.model.initial_shape import InitialShape, initial_shape, initial_shape_reference
from quaffure.model.prepared_groom import PackedGroom, PreparedGroom, pack_groom, prepare_groom
from quaffure.model.projection import projected
from quaffure.model.quaffure_network import DirectionNetwork, DisplacementNetwork, NetworkInputs, QuaffureNetwork
from quaffure.scene import BodyBatch, Scene
from quaffure.types import Positions, Tensor


class NeuralDraper:
    """hair = posed + deformation, the deformation from a network.

    Where strands slide along the skin before the network, `drape` pushes what the network leaves in the skin out of it
    (`quaffure.model.projection`); `deform`, which trainings differentiate, and the paper's configuration do not.

    Attributes:
        network: either configuration. Its weights may change between drapes, but not in place behind the back of
            autograd (`.data`), which nobody notices.
        material: the one that the network was trained for.
        bf16: run the network's layers in bfloat16; all geometry stays in float32.
    """

    name = "neural"

    def __init__(self, network: QuaffureNetwork, material: HairMaterial, bf16: bool = False) -> None:
        self.network, self.material, self.bf16 = network, material, bf16
        self._parameters = tuple(network.parameters())  # asking for them takes longer than posing the body
        self._fitted: WeakKeyDictionary[Groom, WeakKeyDictionary[BodyModel, PreparedGroom]] = WeakKeyDictionary()
        self._compiled: tuple[object, CompiledDrape] | None = None

    def drape(self, scene: Scene) -> Positions:
        bodies, groom = scene.bodies, scene.groom
        if not self.is_compiled(bodies.body):
            with torch.no_grad():
                return self._out_of_skin(scene, self.deform(scene))
        draped = torch.empty(len(bodies.body_pose), *groom.rest_strands.shape)
        self._drape_compiled([groom] * len(draped), bodies, list(draped))
        return draped

    def drape_grooms(self, grooms: Sequence[Groom], bodies: BodyBatch) -> list[Tensor]:
        """Each groom draped on the body of its row: [strand, vertex, 3] of each [m, world]."""
        if self.is_compiled(bodies.body):
            draped = [torch.empty(groom.rest_strands.shape) for groom in grooms]
            self._drape_compiled(grooms, bodies, draped)
            return draped
        rows = zip(grooms, bodies.body_pose.split(1), bodies.body_shape.split(1))
        return [self.drape(Scene(groom, BodyBatch(bodies.body, pose, shape)))[0] for groom, pose, shape in rows]

    def deform(self, scene: Scene) -> Positions:
        """Vertices [m] as the network has them, differentiable in its weights but for the encoder's."""
        bodies, fitted = scene.bodies, self._fit(scene.groom, scene.bodies.body)
        view = head_frame_body(bodies.body, bodies.body_pose, bodies.body_shape)
        if isinstance(self.network, DisplacementNetwork):
            return self._displaced(scene, fitted, view, self.network)
        with torch.no_grad():
            start = self._start(scene, fitted, view)
        with self._layers_in_bfloat16(view):
            change = self.network(NetworkInputs(fitted.code, scene.groom.texels(), view.pose_code), start.told)
        edges = (start.edges + start.compliance[..., None] * change) @ view.world_from_head[:, None].mT
        return integrate_directions(scene.posed[:, :, 0], edges, fitted.rest_length)

    def is_compiled(self, body: BodyModel) -> bool:
        """Whether drapes on this body come from kernels: our configuration, in float32 on the CPU."""
        return isinstance(self.network, DirectionNetwork) and self.network.config.views and _on_cpu(body)

    def compiled(self) -> CompiledDrape:
        """The network as kernels; made anew when anything that decides a drape has changed."""
        weights = [(p.data_ptr(), None if p.is_inference() else p._version) for p in self._parameters]
        state = (weights, self.material, self.bf16)
        if self._compiled is None or self._compiled[0] != state:
            assert isinstance(self.network, DirectionNetwork)
            network = InferenceNetwork(self.network, torch.bfloat16 if self.bf16 else torch.float32)
            self._compiled = state, CompiledDrape(network, self.material)
        return self._compiled[1]

    def packed(self, groom: Groom, body: BodyModel) -> PackedGroom:
        """What the kernels need of a groom on the CPU; kept as long as groom and body are.

        Raises:
            InputError: the groom is not laid out for the network, or a root is not on the scalp.
        """
        fitted = self._fit(groom, body)
        assert isinstance(fitted, PackedGroom)
        return fitted

    def _fit(self, groom: Groom, body: BodyModel) -> PreparedGroom:
        on_bodies = self._fitted.setdefault(groom, WeakKeyDictionary())
        if body not in on_bodies:
            with torch.no_grad():
                fitted = prepare_groom(groom, body, self.network, self.material)
            on_bodies[body] = pack_groom(groom, body, fitted) if _on_cpu(body) else fitted
        return on_bodies[body]

    def _drape_compiled(self, grooms: Sequence[Groom], bodies: BodyBatch, draped: Sequence[Tensor]) -> None:
        compiled, body = self.compiled(), bodies.body
        for first in range(0, len(grooms), BATCH):
            part = slice(first, first + BATCH)
            packed = [self.packed(groom, body) for groom in grooms[part]]
            compiled.drape(packed, body, bodies.body_pose[part], bodies.body_shape[part], draped[part])

    def _displaced(
        self, scene: Scene, fitted: PreparedGroom, view: HeadFrameBody, network: DisplacementNetwork
    ) -> Positions:
        with self._layers_in_bfloat16(view):
            moved = network(NetworkInputs(fitted.code, scene.groom.texels(), view.pose_code))
        moved = torch.cat([torch.zeros_like(moved[:, :, :1]), moved[:, :, 1:]], dim=2)  # roots do not move
        return scene.posed + moved @ view.world_from_head[:, None].mT

    def _out_of_skin(self, scene: Scene, deformed: Positions) -> Positions:
        if isinstance(self.network, DisplacementNetwork) or not self.network.config.slides:
            return deformed
        bodies, fitted = scene.bodies, self._fit(scene.groom, scene.bodies.body)
        return projected(deformed, fitted.rest_length, fitted.clearance, bodies)

    def _layers_in_bfloat16(self, view: HeadFrameBody) -> torch.autocast:
        return torch.autocast(view.head.device.type, torch.bfloat16, enabled=self.bf16)

    def _start(self, scene: Scene, fitted: PreparedGroom, view: HeadFrameBody) -> InitialShape:
        body = scene.bodies.body
        if _on_cpu(body):
            return initial_shape(self.packed(scene.groom, body).packets, view, self.material)
        return initial_shape_reference(scene.groom, body, view, self.material, fitted.margin, fitted.leader)


def _on_cpu(body: BodyModel) -> bool:
    return body.rest_vertices.device.type == "cpu" and body.rest_vertices.dtype == torch.float32
