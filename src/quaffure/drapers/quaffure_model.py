"""The shipped network on its body, ready to drape."""

from importlib.resources import files
from pathlib import Path

import torch

from quaffure.body.body_model import BodyModel, load_body
from quaffure.config import VERTICES_PER_STRAND
from quaffure.drapers.neural import NeuralDraper
from quaffure.drapers.scene import BodyBatch, Scene
from quaffure.errors import InputError
from quaffure.groom.groom import Groom
from quaffure.networks.checkpoint import load_network
from quaffure.networks.quaffure_network import POSE_SIZE, SHAPE_SIZE
from quaffure.types import Positions, Tensor

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

    def drape(self, groom: Groom, body_pose: Tensor, body_shape: Tensor) -> Positions:
        """Hair at rest under gravity and contact.

        Args:
            groom: registered to the body, at most one strand a texel (`quaffure.load_groom`).
            body_pose: [batch, 81], axis-angle of every joint (theta) [rad].
            body_shape: [batch, 10], shape coefficients (beta) [standard deviations].

        Returns:
            Draped vertices [m, world].

        Raises:
            InputError: an array of another shape, or a groom that is not laid out for the network.
        """
        self._check(groom, body_pose, body_shape)
        device = self.body.rest_vertices.device
        bodies = BodyBatch(self.body, body_pose.to(device), body_shape.to(device))
        return self.draper.drape(Scene(groom.to(device), bodies))

    @staticmethod
    def _check(groom: Groom, body_pose: Tensor, body_shape: Tensor) -> None:
        batch = len(body_pose)
        if body_pose.shape != (batch, POSE_SIZE):
            raise InputError("body_pose", f"[batch, {POSE_SIZE}]", f"{list(body_pose.shape)}")
        if body_shape.shape != (batch, SHAPE_SIZE):
            raise InputError("body_shape", f"[{batch}, {SHAPE_SIZE}]", f"{list(body_shape.shape)}")
        if groom.rest_strands.shape[1] != VERTICES_PER_STRAND:
            raise InputError(groom.name, f"{VERTICES_PER_STRAND} vertices a strand", f"{groom.rest_strands.shape[1]}")
        if groom.texels().unique().numel() != len(groom):
            raise InputError(groom.name, "one strand a texel (`select_guides`)", "several in one")


def load_model(path: str | Path | None = None, device: torch.device | str = "cpu") -> Quaffure:
    """The shipped weights, or those of a training run.

    Raises:
        InputError: `path` is no checkpoint of this package.
    """
    network, material, notes = load_network(path or WEIGHTS)
    return Quaffure(load_body().to(device), NeuralDraper(network.to(device), material), notes)
