"""The supervised baseline: GroomGen's neural quasi-static simulator as the paper re-implements it (Sec. 4.2).

Known from the paper: there is no public code, so it compares with its own re-implementation; one network is for one
groom; it is supervised by a quasi-static simulation of 1,000 body poses with neck rotations within 30 degrees along
(x, y, z), where the original saw directions of gravity; it takes 2.49 ms against 2.86 ms of the paper's own network.
GroomGen (Zhou et al. 2023) itself describes hair by a latent code for each strand on the scalp, and decodes all strands
by one network. Layers, outputs and loss are not printed.

Chosen here: the rotation of the head relative to the trunk goes in. The decoder of the paper's own network, which makes
for like times, draws a texture of strand latents over the scalp; layers common to all strands read a strand's latent
and its rest shape and predict displacements of its vertices from the posed groom, in the head's frame, without
lengths or bodies as inputs. They are added to the mean of the simulated displacements. The loss is
the mean squared distance to the simulated vertices.
"""

import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from torch import nn

from quaffure.config import TEXTURE_SIZE, VERTICES_PER_STRAND, HairMaterial
from quaffure.errors import InputError, refused
from quaffure.file_values import known_fields, material_from
from quaffure.model.deformation_decoder import DeformationDecoder
from quaffure.model.groom_autoencoder import Widths, start_layers
from quaffure.model.weights_file import MAX_WIDTH, read_weights, save_weights
from quaffure.types import Float, Int, Positions, Tensor

DISPLACEMENT_UNIT = 0.05
"""What an output of one means [m], so that the layers work on numbers of about one."""
_TURN_UNIT = math.radians(30)
_REST_UNIT = 0.1
_MOVED = VERTICES_PER_STRAND - 1


@dataclass(frozen=True)
class GroomGenLayers:
    """What a checkpoint needs to rebuild its network, besides the groom."""

    latent_size: int = 32
    """Channels of the strand latents."""
    strand_width: int = 128
    """Width of the two hidden layers common to all strands."""
    widths: Widths = (256, 192, 128, 96)
    """Channels of the decoder at 4, 8, 16 and 32 texels a side."""

    def __post_init__(self) -> None:
        if len(self.widths) != 4:
            raise ValueError(f"expected four widths, found {self.widths!r}")
        for name, values in {
            "latent_size": (self.latent_size,),
            "strand_width": (self.strand_width,),
            "widths": self.widths,
        }.items():
            if not all(isinstance(value, int) and 1 <= value <= MAX_WIDTH for value in values):
                raise ValueError(f"expected {name} from 1 to {MAX_WIDTH}, found {values!r}")


class GroomGenNetwork(nn.Module):
    """A turn of the head to the displacement [m] of every vertex of one groom, in the head's frame.

    Attributes:
        config: its layers.
        rest_strands: the groom that it is for, relative to the head's joint at rest [m], rounded to half precision as
            in its file.
        mean_displacement: of the simulations [m]; zero until a training sets it.
        texel_cells: row and column of each strand's texel. Two numbers, because half precision holds no 4,095.
    """

    rest_strands: Float[Tensor, "s n 3"]
    mean_displacement: Float[Tensor, "s n 3"]
    texel_cells: Int[Tensor, "s 2"]

    def __init__(
        self, config: GroomGenLayers, rest_strands: Float[Tensor, "s n 3"], texel_cells: Int[Tensor, "s 2"]
    ) -> None:
        super().__init__()
        self.config = config
        self.register_buffer("rest_strands", rest_strands.half().float())
        self.register_buffer("mean_displacement", torch.zeros_like(rest_strands))
        self.register_buffer("texel_cells", texel_cells)
        self.decoder = DeformationDecoder(3, config.latent_size, config.widths)
        width = config.strand_width
        self.strand = nn.Sequential(
            *(nn.Linear(config.latent_size + 3 * VERTICES_PER_STRAND, width), nn.SiLU()),
            *(nn.Linear(width, width), nn.SiLU()),
            nn.Linear(width, 3 * _MOVED),
        )
        start_layers(self)
        for parameter in self.strand[-1].parameters():
            nn.init.zeros_(parameter)  # an untrained network predicts the mean

    @property
    def texels(self) -> Int[Tensor, " s"]:
        """Flat index of every strand's texel."""
        return self.texel_cells[:, 0] * TEXTURE_SIZE + self.texel_cells[:, 1]

    def forward(self, turn: Float[Tensor, "b 3"], strands: Int[Tensor, " m"] | None = None) -> Positions:
        """Displacements from the posed groom; that of a root is zero.

        Args:
            turn: rotation vector of the head relative to the trunk [rad].
            strands: indices of some strands; all without it.
        """
        texels, rest, mean = self.texels, self.rest_strands, self.mean_displacement
        if strands is not None:
            texels, rest, mean = texels[strands], rest[strands], mean[strands]
        latents = self.decoder(turn / _TURN_UNIT).index_select(2, texels).mT
        own = (rest.flatten(1) / _REST_UNIT).expand(len(turn), -1, -1)
        moved = self.strand(torch.cat([latents, own.to(latents.dtype)], dim=-1)).float()
        return mean + nn.functional.pad(DISPLACEMENT_UNIT * moved.unflatten(-1, (_MOVED, 3)), (0, 0, 1, 0))


def save_groomgen(path: Path, network: GroomGenNetwork, material: HairMaterial, notes: dict[str, str]) -> None:
    """Write half-precision weights, the groom that they are for, layers, and the material that was simulated."""
    metadata = {"groomgen": json.dumps(asdict(network.config)), "material": json.dumps(asdict(material)), **notes}
    save_weights(path, network, metadata)


def load_groomgen_network(path: str | Path) -> tuple[GroomGenNetwork, HairMaterial, dict[str, str]]:
    """A network in evaluation mode, the material of its hair, and the notes saved with it.

    Raises:
        InputError: the file is missing or not one that `save_groomgen` wrote.
    """
    path, expected = Path(path), "weights of quaffure train-groomgen"
    weights, notes = read_weights(path, f"{expected} (.safetensors)")
    if "groomgen" not in notes:
        raise InputError(path, expected, "weights of another network")
    # Notes are JSON of any kind, and tensors of any shape.
    with refused(path, expected, Exception):
        layers = known_fields(json.loads(notes.pop("groomgen")), GroomGenLayers)
        config = GroomGenLayers(**layers | {"widths": tuple(layers["widths"])})  # JSON has lists alone
        material = material_from(json.loads(notes.pop("material")))
        rest, cells = weights["rest_strands"], weights["texel_cells"].long()
        if rest.shape != (len(cells), VERTICES_PER_STRAND, 3) or not ((cells >= 0) & (cells < TEXTURE_SIZE)).all():
            raise ValueError("another groom's strands")
        network = GroomGenNetwork(config, rest, cells)
        network.load_state_dict(weights)
    return network.eval(), material, notes
