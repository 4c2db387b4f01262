"""The network's drape: one pass, no iterations."""

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import torch

from quaffure.body.body_model import BodyModel
from quaffure.body.motion import without_heading
from quaffure.body.pose_features import HEAD, pose_features, world_from_head
from quaffure.body.soft_body import soft_body
from quaffure.config import HairMaterial
from quaffure.drapers.scene import Scene
from quaffure.energies.closed_form import sagged_vectors
from quaffure.energies.rest_state import RestState, rest_state
from quaffure.geometry.polyline import integrate_directions
from quaffure.geometry.soft_surface import slide, soft_views
from quaffure.groom.groom import Groom
from quaffure.networks.groom_code import groom_code
from quaffure.networks.quaffure_network import POSE_SIZE, SHAPE_SIZE, NetworkInputs, QuaffureNetwork
from quaffure.types import Float, Positions, Tensor

THICKNESS, THICK_FROM = 0.015, 0.2
"""How far above the lowest hair the uppermost starts, and after which length of strand all of it [m]."""
SEEN = 0.05
"""From which amount of a view on it tells a distance."""


@dataclass(frozen=True)
class FittedGroom:
    """What a drape needs of a groom on a body, whatever the pose.

    Attributes:
        rest: rest quantities.
        code: of the frozen encoder.
        margin: see `starting_margin` [m].
    """

    rest: RestState
    code: Float[Tensor, "16"]
    margin: Float[Tensor, "s n"]


class NeuralDraper:
    """hair = posed + deformation, the deformation from a network.

    Attributes:
        network: either configuration.
        material: the one that the network was trained for.
        bf16: run the network's layers in bfloat16; all geometry stays in float32.
    """

    name = "neural"

    def __init__(self, network: QuaffureNetwork, material: HairMaterial, bf16: bool = False) -> None:
        self.network, self.material, self.bf16 = network, material, bf16
        self._fitted: WeakKeyDictionary[Groom, WeakKeyDictionary[BodyModel, FittedGroom]] = WeakKeyDictionary()

    def drape(self, scene: Scene) -> Positions:
        with torch.no_grad():
            return self.deform(scene)

    def deform(self, scene: Scene) -> Positions:
        """Draped vertices [m], differentiable in the network's weights but for the encoder's."""
        fitted = self._fit(scene.groom, scene.bodies.body)
        rest = fitted.rest
        bodies, root, directions = scene.bodies, scene.posed[:, :, 0], self.network.config.output == "directions"
        head = world_from_head(bodies.body, bodies.posed.joint_rotations)[:, None]
        sag = sagged_vectors(scene.director, rest.rest_length, rest.mass_beyond, self.material.k_cosserat)
        surface = soft_body(bodies.body, bodies.posed)
        edges, views = slide(root, sag, rest.rest_length, fitted.margin, surface)
        if not self.network.config.slides:
            edges = torch.nn.functional.normalize(sag, dim=-1)
        inputs = self._inputs(scene, fitted, integrate_directions(root, edges, rest.rest_length), views)
        with torch.autocast(sag.device.type, torch.bfloat16, enabled=self.bf16):
            answer = self.network(inputs)
        answer = answer @ head.mT
        if directions:
            return integrate_directions(root, edges + answer, rest.rest_length)
        answer = torch.cat([torch.zeros_like(answer[:, :, :1]), answer[:, :, 1:]], dim=2)  # roots do not move
        return scene.posed + answer

    def _inputs(
        self, scene: Scene, fitted: FittedGroom, undeformed: Positions, views: Float[Tensor, "b s e 5"]
    ) -> NetworkInputs:
        bodies = scene.bodies
        body, posed_body = bodies.body, bodies.posed
        head = body.joint_names.index(HEAD)
        offset = undeformed[:, :, 1:] - posed_body.joint_positions[:, None, None, head]
        to_head = posed_body.joint_rotations[:, None, head]
        return NetworkInputs(
            groom_code=fitted.code,
            texels=scene.groom.texels(),
            body_pose=without_heading(bodies.body_pose),
            body_shape=bodies.body_shape,
            pose_features=pose_features(body, posed_body.joint_rotations, posed_body.joint_positions),
            undeformed=offset @ to_head,
            views=torch.cat([views[..., :1], views[..., 1:4] @ to_head, views[..., 4:]], dim=-1),
        )

    def _fit(self, groom: Groom, body: BodyModel) -> FittedGroom:
        """Made once for every groom and body that is still in use."""
        on_bodies = self._fitted.setdefault(groom, WeakKeyDictionary())
        if body not in on_bodies:
            rest = rest_state(groom.rest_strands, self.material)
            with torch.no_grad():
                code = groom_code(groom, body, self.network.encoder)
            on_bodies[body] = FittedGroom(rest, code, starting_margin(groom, rest, body))
        return on_bodies[body]


def starting_margin(groom: Groom, rest: RestState, body: BodyModel) -> Float[Tensor, "s n"]:
    """Distance from the softened body that strands start with [m].

    Hair that roots higher lies on top: without it all hair would start in one layer, pressed to many times its
    density. Nothing has to be further out than it is at rest, where hair may lie closer to the head than a softened
    body is true.
    """
    height = groom.rest_strands[:, 0, 2].argsort().argsort() / len(groom)
    arc = torch.nn.functional.pad(rest.rest_length.cumsum(dim=1), (1, 0))
    layered = rest.collision_margin + THICKNESS * height[:, None] * (arc / THICK_FROM).clamp(max=1)
    at_rest = body.pose(rest.rest_length.new_zeros(1, POSE_SIZE), rest.rest_length.new_zeros(1, SHAPE_SIZE))
    surface = soft_body(body, at_rest)
    views = soft_views(groom.rest_strands.flatten(0, 1)[None], surface).unflatten(1, layered.shape)[0]
    seen = views[..., 4]
    clearance = torch.where(seen > SEEN, surface.radius * views[..., 0] / seen.clamp(min=SEEN), torch.inf)
    return torch.minimum(layered, clearance)
