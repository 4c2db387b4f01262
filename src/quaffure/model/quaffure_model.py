"""The shipped network on its body, ready to drape."""

from collections.abc import Iterable, Iterator
from importlib.resources import files
from itertools import islice
from pathlib import Path

import torch

from quaffure.backend import Backend, choose_backend
from quaffure.body.body_model import BodyModel, load_body
from quaffure.body.pose_limits import Rows, rows_of
from quaffure.energies.loading import Loading
from quaffure.errors import InputError
from quaffure.hair.groom import Groom
from quaffure.hair.groom_cache import GroomCache
from quaffure.hair.groom_checks import check_groom
from quaffure.model.checkpoint import load_network
from quaffure.model.cpu_backend import BATCH
from quaffure.model.inference_network import fast_bfloat16
from quaffure.model.network_config import POSE_SIZE, SHAPE_SIZE
from quaffure.model.neural import NeuralDraper
from quaffure.scene import BodyBatch, Scene
from quaffure.types import Positions, Tensor

PAPER = "paper"
"""The model of the paper's configuration: displacements of vertices, trained on Eqs. 6 to 14."""
MODELS = {name: Path(str(files("quaffure") / "assets" / f"{name}.safetensors")) for name in ("quaffure", PAPER)}
WEIGHTS = MODELS["quaffure"]


class Quaffure:
    """A trained network and the body that it was trained on.

    Attributes:
        body: the body model.
        draper: the network as a `Draper`.
        notes: how the weights were made.
    """

    def __init__(self, body: BodyModel, draper: NeuralDraper, notes: dict[str, str]) -> None:
        self.body, self.draper, self.notes = body, draper, notes
        self._moved: GroomCache[Groom] = GroomCache()  # to the body's device; what was prepared of them is kept by them

    def __repr__(self) -> str:
        return f"Quaffure({self.draper.name} on {self.body!r})"

    def with_loading(self, loading: Loading) -> "Quaffure":
        """The same network for hair of another stiffness, or under another gravity and wind; it shares weights and
        prepared grooms with this one.

        Raises:
            InputError: see `NeuralDraper.with_loading`.
        """
        return Quaffure(self.body, self.draper.with_loading(loading), self.notes)

    def on(self, body: BodyModel) -> "Quaffure":
        """The same network on another body, of a character for instance (`quaffure.load_body`); it shares weights with
        this one. Grooms must be loaded for that body, `load_groom(name, body)`; those of another one are refused.
        """
        like = self.body.rest_vertices
        return Quaffure(body.to(like.device, like.dtype), self.draper, self.notes)

    def drape(self, groom: Groom, body_pose: Rows, body_shape: Rows | None = None) -> Positions:
        """Hair at rest under gravity and contact.

        Args:
            groom: registered to the body, at most one strand a texel (`quaffure.load_groom`).
            body_pose: [batch, 81], axis-angle of every joint (theta), at most 4 pi long [rad]; a tensor, an array or
                lists.
            body_shape: [batch, 10], shape coefficients (beta) within +-10 [standard deviations]; the mean without.

        Returns:
            Draped vertices [m, world], without gradient.

        Raises:
            InputError: an array of another shape, numbers that are not finite or beyond these limits, a groom without
                strands, with NaN, of another body, or not laid out for the network, or a pose or shape whose gradient
                is asked for.
        """
        given_shape = [[0.0] * SHAPE_SIZE] if body_shape is None else body_shape
        poses = rows_of(body_pose, POSE_SIZE, self.body.rest_vertices, "body_pose")
        shapes = rows_of(given_shape, SHAPE_SIZE, self.body.rest_vertices, "body_shape")
        if body_shape is None:
            shapes = shapes.expand(len(poses), -1)
        if not 0 < len(shapes) == len(poses):
            raise InputError("body_shape", f"[{max(len(poses), 1)}, {SHAPE_SIZE}]", f"{list(shapes.shape)}")
        if poses.requires_grad or shapes.requires_grad:
            _check_no_gradient(poses, shapes)
        return self.draper.drape(Scene(self._checked(groom), BodyBatch(self.body, poses, shapes)))

    def drape_many(self, grooms: Iterable[Groom], body_pose: Rows, body_shape: Rows) -> Iterator[Tensor]:
        """Many hairstyles, one after another, each as soon as its batch is done.

        Memory does not grow with them where `grooms` makes them one by one: what is prepared for a groom, some 1000
        bytes a strand, is kept as long as somebody holds the groom.

        Args:
            grooms: as for `drape`.
            body_pose, body_shape: a row for each groom, or one that all of them share.

        Returns:
            Iterator of the draped vertices of each groom in turn, [strand, vertex, 3] [m, world].

        Raises:
            InputError: as for `drape`, what concerns the grooms while iterating, where also other numbers of rows than
                of grooms are refused.
        """
        poses, shapes = self.body.checked_pose_and_shape(body_pose, body_shape)
        if poses.requires_grad or shapes.requires_grad:
            _check_no_gradient(poses, shapes)
        return self._drape_many(grooms, poses, shapes)

    def _drape_many(self, grooms: Iterable[Groom], poses: Tensor, shapes: Tensor) -> Iterator[Tensor]:
        first, waiting = 0, iter(grooms)
        while batch := [self._checked(groom) for groom in islice(waiting, BATCH)]:
            rows = range(first, first + len(batch))
            bodies = BodyBatch(self.body, _taken("body_pose", poses, rows), _taken("body_shape", shapes, rows))
            for hair in self.draper.drape_grooms(batch, bodies):
                yield from hair
            first += len(batch)
        for name, values in (("body_pose", poses), ("body_shape", shapes)):
            if len(values) not in (1, first):
                raise InputError(name, f"a row for each groom, {first}, or a single one", f"{len(values)}")

    def _checked(self, groom: Groom) -> Groom:
        """The groom on the body's device."""
        if not isinstance(groom, Groom):
            raise InputError("groom", "a Groom (`quaffure.load_groom`)", f"{groom!r}")
        expected, found = self.body.rest_vertices, groom.rest_strands
        if found.dtype is not expected.dtype:
            raise InputError(groom.name, f"vertices in {expected.dtype}", f"{found.dtype}")
        check_groom(groom, len(self.body.faces))
        device = expected.device
        return groom if found.device == device else self._moved.of(groom, lambda: groom.to(device))


def _check_no_gradient(poses: Tensor, shapes: Tensor) -> None:
    """A result without gradient would let a fit stand still without a word."""
    for name, values in (("body_pose", poses), ("body_shape", shapes)):
        if torch.is_grad_enabled() and values.requires_grad:
            expected = (
                "values without gradient, which drape does not have (NeuralDraper(network, material, "
                "backend=Backend.TORCH).deform has it; torch.no_grad() drapes without)"
            )
            raise InputError(name, expected, "requires_grad")


def _taken(name: str, values: Tensor, rows: range) -> Tensor:
    if len(values) == 1:
        return values.expand(len(rows), -1)
    if len(values) < rows.stop:
        raise InputError(name, f"a row for each groom, {rows.stop} or more, or a single one", f"{len(values)}")
    return values[rows.start : rows.stop]


def load_model(
    path: str | Path | None = None, device: torch.device | str = "cpu", bf16: bool | None = None
) -> Quaffure:
    """The shipped weights, or those of a training run.

    Args:
        path: a file, or `paper` for the paper's configuration, which is shipped as well.
        bf16: run the network's layers in bfloat16, which moves vertices by some hundredths of a millimetre; None:
            where the CPU multiplies such matrices in hardware.

    Raises:
        InputError: `path` is no checkpoint of this package.
    """
    network, material, notes = load_network(MODELS.get(str(path), path) if path else WEIGHTS)
    body = load_body().to(device)
    if bf16 is None:
        bf16 = choose_backend(body.rest_vertices) is Backend.CPU and fast_bfloat16()
    return Quaffure(body, NeuralDraper(network.to(device), material, bf16), notes)
