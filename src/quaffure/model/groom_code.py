"""The frozen groom encoder and the code of a groom; files of encoder and autoencoder."""

import re
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TypeVar

import torch
from torch import nn

from quaffure.body.body_model import BodyModel, load_body
from quaffure.errors import InputError, refused
from quaffure.hair.groom import Groom
from quaffure.model.groom_autoencoder import GroomAutoencoder, Widths
from quaffure.model.groom_encoder import GroomEncoder
from quaffure.model.groom_texture import TEXTURE_CHANNELS, groom_texture
from quaffure.model.weights_file import MAX_WIDTH, read_weights, save_weights
from quaffure.types import Float, Tensor

WEIGHTS = Path(str(files("quaffure") / "assets" / "groom_code.safetensors"))
_ENCODER_FILE = "weights of a groom encoder (.safetensors)"
Network = TypeVar("Network", bound=nn.Module)


@torch.no_grad()
def groom_code(groom: Groom, body: BodyModel | None = None, encoder: GroomEncoder | None = None) -> Float[Tensor, "16"]:
    """The code of a hairstyle, numbers of about one; independent of the order of the strands.

    Args:
        groom: registered to `body`, at most one strand a texel (`quaffure.load_groom`).
        body: the shipped one where none is given.
        encoder: the shipped one where none is given.

    Raises:
        InputError: not 24 vertices a strand, two strands in one texel, or a root that is not on the scalp.
    """
    texture = groom_texture(groom, body or load_body())
    return (encoder or _shipped_encoder())(texture)[0]


def load_groom_encoder(path: str | Path | None = None) -> GroomEncoder:
    """The shipped encoder, or that of a training run; in evaluation mode, its weights frozen.

    Raises:
        InputError: the file is missing or holds no groom encoder.
    """
    path = Path(path or WEIGHTS)
    weights, _ = read_weights(path, _ENCODER_FILE)
    return _filled(GroomEncoder(TEXTURE_CHANNELS), weights, path)


def load_groom_autoencoder(path: str | Path) -> GroomAutoencoder:
    """Encoder and decoder of a training run; in evaluation mode, their weights frozen.

    Raises:
        InputError: the file is missing or holds no groom autoencoder.
    """
    path = Path(path)
    weights, notes = read_weights(path, _ENCODER_FILE)
    return _filled(GroomAutoencoder(_widths(path, notes.get("widths", ""))), weights, path)


def save_encoder(path: Path, network: GroomAutoencoder, notes: dict[str, str]) -> None:
    """Write the encoder alone, in half precision."""
    save_weights(path, network.encoder, notes)


def save_autoencoder(path: Path, network: GroomAutoencoder, notes: dict[str, str]) -> None:
    """Write encoder and decoder, in half precision."""
    save_weights(path, network, notes | {"widths": ",".join(map(str, network.widths))})


def _widths(path: Path, text: str) -> Widths:
    words = text.split(",")
    widths = [int(word) for word in words if re.fullmatch(r"\d{1,4}", word)]
    if len(widths) != len(words) or len(words) != 4 or not all(0 < width <= MAX_WIDTH for width in widths):
        raise InputError(path, "the four widths of a groom decoder", f"{text[:40]!r}")
    return widths[0], widths[1], widths[2], widths[3]


def _filled(network: Network, weights: dict[str, Tensor], path: Path) -> Network:
    with refused(path, f"weights of a {type(network).__name__}", RuntimeError):
        network.load_state_dict(weights)
    return network.eval().requires_grad_(False)


@cache
def _shipped_encoder() -> GroomEncoder:
    return load_groom_encoder()
