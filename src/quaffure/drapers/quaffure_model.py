"""The shipped network on its body, ready to drape."""

from importlib.resources import files
from pathlib import Path

import torch

from quaffure.body.body_model import BodyModel, load_body
from quaffure.drapers.neural import NeuralDraper
from quaffure.drapers.scene import BodyBatch, Scene
from quaffure.groom.groom import Groom
from quaffure.networks.checkpoint import load_network
from quaffure.types import BodyPose, BodyShape, Positions

WEIGHTS = Path(str(files("quaffure") / "assets" / "quaffure.safetensors"))


class Quaffure:
    """A trained network and the body that it was trained on.

    Attributes:
        body: the body model.
        draper: the network as a `Draper`.
        notes: how the weights were made.
    """

    def __init__(self, body: BodyModel, draper: NeuralDraper, notes: dict[str, str]) -> None:
        self.body, self.draper, self.notes = body, draper, notes

    def drape(self, groom: Groom, body_pose: BodyPose, body_shape: BodyShape) -> Positions:
        """Hair at rest under gravity and contact.

        Args:
            groom: registered to the body, at most one strand a texel (`quaffure.load_groom`).
            body_pose: axis-angle of every joint (theta) [rad].
            body_shape: shape coefficients (beta) [standard deviations].

        Returns:
            Draped vertices [m, world].
        """
        return self.draper.drape(Scene(groom, BodyBatch(self.body, body_pose, body_shape)))


def load_model(path: Path | None = None, device: torch.device | str = "cpu") -> Quaffure:
    """The shipped weights, or those of a training run.

    Raises:
        InputError: `path` is no checkpoint of this package.
    """
    network, material, notes = load_network(path or WEIGHTS)
    return Quaffure(load_body().to(device), NeuralDraper(network.to(device), material), notes)
