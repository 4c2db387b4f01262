"""The network's drape: one pass, no iterations."""

import torch

from quaffure.body.motion import without_heading
from quaffure.body.pose_features import HEAD, pose_features, world_from_head
from quaffure.config import HairMaterial
from quaffure.drapers.scene import Scene
from quaffure.energies.closed_form import sagged_vectors
from quaffure.energies.rest_state import RestState, rest_state
from quaffure.geometry.polyline import integrate_directions
from quaffure.groom.groom import Groom
from quaffure.groom.scalp_texture import encode
from quaffure.networks.quaffure_network import NetworkInputs, QuaffureNetwork
from quaffure.types import Float, Positions, Tensor

_METRES = 0.1  # what one unit of the rest texture means


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

    def drape(self, scene: Scene) -> Positions:
        with torch.no_grad():
            return self.deform(scene, rest_state(scene.groom.rest_strands, self.material))

    def deform(self, scene: Scene, rest: RestState) -> Positions:
        """Draped vertices [m], differentiable in the network's weights."""
        head = world_from_head(scene.bodies.body, scene.bodies.posed.joint_rotations)[:, None]
        sag = sagged_vectors(scene.director, rest.rest_length, rest.mass_beyond, self.material.k_cosserat)
        inputs = self._inputs(scene, integrate_directions(scene.posed[:, :, 0], sag, rest.rest_length))
        with torch.autocast(sag.device.type, torch.bfloat16, enabled=self.bf16):
            answer = self.network(inputs)
        answer = answer @ head.mT
        if self.network.config.output == "directions":
            vectors = torch.nn.functional.normalize(sag, dim=-1) + answer
            return integrate_directions(scene.posed[:, :, 0], vectors, rest.rest_length)
        answer = torch.cat([torch.zeros_like(answer[:, :, :1]), answer[:, :, 1:]], dim=2)  # roots do not move
        return scene.posed + answer

    def _inputs(self, scene: Scene, sagged: Positions) -> NetworkInputs:
        bodies = scene.bodies
        body, posed_body = bodies.body, bodies.posed
        head = body.joint_names.index(HEAD)
        offset = sagged[:, :, 1:] - posed_body.joint_positions[:, None, None, head]
        return NetworkInputs(
            rest_texture=rest_texture(scene.groom, body.rest_joints[head]),
            texels=scene.groom.texels(),
            body_pose=without_heading(bodies.body_pose),
            body_shape=bodies.body_shape,
            pose_features=pose_features(body, posed_body.joint_rotations, posed_body.joint_positions),
            undeformed=offset @ posed_body.joint_rotations[:, None, head],
        )


def rest_texture(groom: Groom, rest_head: Float[Tensor, "3"]) -> Float[Tensor, "1 channels 64 64"]:
    """Rest vertices relative to the head joint on the scalp's texture, and the mask of texels that hold a strand.

    Raises:
        ValueError: two strands share a texel.
    """
    own = ((groom.rest_strands - rest_head) / _METRES).flatten(1)
    texture, mask = encode(groom, own)
    return torch.cat([texture, mask[..., None].to(texture)], dim=-1).permute(2, 0, 1)[None]
