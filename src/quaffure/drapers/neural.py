"""The network's drape: one pass, no iterations."""

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
from quaffure.networks.groom_texture import groom_texture
from quaffure.networks.quaffure_network import POSE_SIZE, SHAPE_SIZE, NetworkInputs, QuaffureNetwork
from quaffure.types import Float, Positions, Tensor

THICKNESS, THICK_FROM = 0.015, 0.2
"""How far above the lowest hair the uppermost starts, and after which length of strand all of it [m]."""
SEEN = 0.05
"""From which amount of a view on it tells a distance."""


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
        self._codes: WeakKeyDictionary[Groom, Tensor] = WeakKeyDictionary()
        self._margins: WeakKeyDictionary[Groom, Tensor] = WeakKeyDictionary()

    def drape(self, scene: Scene) -> Positions:
        with torch.no_grad():
            return self.deform(scene, rest_state(scene.groom.rest_strands, self.material))

    def deform(self, scene: Scene, rest: RestState) -> Positions:
        """Draped vertices [m], differentiable in the network's weights."""
        bodies, root, directions = scene.bodies, scene.posed[:, :, 0], self.network.config.output == "directions"
        head = world_from_head(bodies.body, bodies.posed.joint_rotations)[:, None]
        sag = sagged_vectors(scene.director, rest.rest_length, rest.mass_beyond, self.material.k_cosserat)
        surface = soft_body(bodies.body, bodies.posed)
        edges, views = slide(root, sag, rest.rest_length, self._margin(scene.groom, rest, bodies.body), surface)
        if not self.network.config.slides:
            edges = torch.nn.functional.normalize(sag, dim=-1)
        inputs = self._inputs(scene, integrate_directions(root, edges, rest.rest_length), views)
        with torch.autocast(sag.device.type, torch.bfloat16, enabled=self.bf16):
            answer = self.network(inputs)
        answer = answer @ head.mT
        if directions:
            return integrate_directions(root, edges + answer, rest.rest_length)
        answer = torch.cat([torch.zeros_like(answer[:, :, :1]), answer[:, :, 1:]], dim=2)  # roots do not move
        return scene.posed + answer

    def _inputs(self, scene: Scene, undeformed: Positions, views: Float[Tensor, "b s e 5"]) -> NetworkInputs:
        bodies = scene.bodies
        body, posed_body = bodies.body, bodies.posed
        head = body.joint_names.index(HEAD)
        offset = undeformed[:, :, 1:] - posed_body.joint_positions[:, None, None, head]
        to_head = posed_body.joint_rotations[:, None, head]
        return NetworkInputs(
            groom_code=self._code(scene.groom, body),
            texels=scene.groom.texels(),
            body_pose=without_heading(bodies.body_pose),
            body_shape=bodies.body_shape,
            pose_features=pose_features(body, posed_body.joint_rotations, posed_body.joint_positions),
            undeformed=offset @ to_head,
            views=torch.cat([views[..., :1], views[..., 1:4] @ to_head, views[..., 4:]], dim=-1),
        )

    def _code(self, groom: Groom, body: BodyModel) -> Float[Tensor, "16"]:
        if groom not in self._codes:
            with torch.no_grad():
                self._codes[groom] = self.network.encoder(groom_texture(groom, body))[0]
        return self._codes[groom]

    def _margin(self, groom: Groom, rest: RestState, body: BodyModel) -> Float[Tensor, "s n"]:
        if groom not in self._margins:
            self._margins[groom] = starting_margin(groom, rest, body)
        return self._margins[groom]


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
