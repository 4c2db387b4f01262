"""The supervised baseline's drape: one pass, for one groom."""

from pathlib import Path

import torch

from quaffure.baselines.groomgen_network import GroomGenNetwork, load_groomgen_network
from quaffure.body.body_model import BodyModel
from quaffure.body.neck import head_rotation
from quaffure.body.pose_features import HEAD, world_from_head
from quaffure.config import TEXTURE_SIZE, HairMaterial
from quaffure.errors import InputError
from quaffure.hair.groom import Groom
from quaffure.hair.groom_cache import GroomCache
from quaffure.scene import Scene
from quaffure.types import Float, Int, Positions, Tensor

SLACK = 1e-3
"""How far a vertex may be from that of the groom that was trained on [m]: weights are kept in half precision, and a
groom that is generated elsewhere differs in its last digits."""


class GroomGenDraper:
    """hair = posed + displacement, the displacement from a network that was fitted to simulations of this very groom.

    Its input is the rotation of the head relative to the trunk; it does not depend on the body's shape.

    Attributes:
        network: of one groom.
        material: the one that was simulated.
    """

    name = "groomgen"

    def __init__(self, network: GroomGenNetwork, material: HairMaterial) -> None:
        self.network, self.material = network, material
        self._found: GroomCache[Int[Tensor, " s"]] = GroomCache()

    @torch.no_grad()
    def drape(self, scene: Scene) -> Positions:
        """Draped vertices [m, world].

        Raises:
            InputError: a groom with a strand that the network was not trained on.
        """
        body, posed = scene.bodies.body, scene.bodies.posed
        strands = self._strands(scene.groom, body)
        moved = self.network(head_rotation(body, posed.joint_rotations), strands)
        return scene.posed + moved @ world_from_head(body, posed.joint_rotations)[:, None].mT

    def knows(self, groom: Groom, body: BodyModel) -> bool:
        """Whether this is the groom that was trained on, or some of its strands."""
        return find_strands(self.network, groom, body) is not None

    def _strands(self, groom: Groom, body: BodyModel) -> Int[Tensor, " s"]:
        def find() -> Int[Tensor, " s"]:
            found = find_strands(self.network, groom, body)
            if found is None:
                expected = f"the groom of {len(self.network.rest_strands)} strands that groomgen was trained on"
                raise InputError(groom.name, expected, f"another of {len(groom)}")
            return found

        return self._found.of(groom, find)


def head_strands(groom: Groom, body: BodyModel) -> Float[Tensor, "s n 3"]:
    """The groom at rest, relative to the head's joint [m]."""
    return groom.rest_strands - body.rest_joints[body.joint_names.index(HEAD)]


def texel_cells(groom: Groom) -> Int[Tensor, "s 2"]:
    """Row and column of every strand's texel."""
    texels = groom.texels()
    return torch.stack([texels // TEXTURE_SIZE, texels % TEXTURE_SIZE], dim=1)


def find_strands(network: GroomGenNetwork, groom: Groom, body: BodyModel) -> Int[Tensor, " s"] | None:
    """Index among the network's strands of every strand of a groom; None where one is not among them."""
    rest = head_strands(groom, body)
    if rest.shape[1:] != network.rest_strands.shape[1:]:
        return None
    index_at = torch.full((TEXTURE_SIZE**2,), -1, device=rest.device)
    index_at[network.texels] = torch.arange(len(network.texels), device=rest.device)
    found = index_at[groom.texels()]
    if bool((found < 0).any()) or bool(((rest - network.rest_strands[found]).norm(dim=-1) > SLACK).any()):
        return None
    return found


def load_groomgen(path: str | Path) -> tuple[GroomGenDraper, dict[str, str]]:
    """The draper of a training run (`quaffure train-groomgen`), and how its weights were made.

    Raises:
        InputError: `path` holds no such weights.
    """
    network, material, notes = load_groomgen_network(path)
    return GroomGenDraper(network, material), notes
