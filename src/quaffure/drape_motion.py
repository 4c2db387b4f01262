"""A motion draped a few frames at a time; the drapes of all frames are kept."""

import time
from collections.abc import Callable
from dataclasses import asdict
from importlib.metadata import version

import numpy as np
import torch

from quaffure.body.body_model import BodyModel
from quaffure.body.motion import Motion
from quaffure.config import HairMaterial
from quaffure.draper import ClipDraper, Draper
from quaffure.errors import refused
from quaffure.file_values import material_from
from quaffure.hair.drape_sequence import DrapeSequence
from quaffure.hair.groom import Groom
from quaffure.hair.strands import held_parts_of
from quaffure.scene import BodyBatch, Scene
from quaffure.types import Float, Positions, Tensor

FRAMES_AT_ONCE = 8


def drape_motion(
    draper: Draper,
    groom: Groom,
    body: BodyModel,
    motion: Motion,
    body_shape: Float[Tensor, "10"],
    on_frames: Callable[[Positions, Scene], None] = lambda draped, scene: None,
    follows: bool = False,
) -> DrapeSequence:
    """Drape the frames in their order, each by itself unless the draper follows from frame to frame.

    Frames are draped in place, where float32 is finest, and then moved along the path of the motion.

    Args:
        on_frames: called with each batch of frames' drapes and scene, in place.
        follows: the frames follow those that the draper draped last, at its rate; otherwise the first is settled anew.

    Returns:
        The drapes. `meta` says what made them, and `milliseconds`, the median wall time of one drape, from pose in to
        strands out, in batches of `FRAMES_AT_ONCE`, the first batch left out where there are others.
    """
    if isinstance(draper, ClipDraper) and not follows:
        draper.restart()
        draper.frame_seconds = 1 / motion.fps
    strands, posed, vertices, times = [], [], [], []
    for body_pose in motion.body_pose.split(FRAMES_AT_ONCE):
        start = time.perf_counter()
        scene = Scene(groom, BodyBatch(body, body_pose, body_shape.expand(len(body_pose), -1)))
        strands.append(draper.drape(scene).detach())
        times.append(1000 * (time.perf_counter() - start) / len(body_pose))
        posed.append(scene.posed)
        vertices.append(scene.bodies.posed.vertices)
        on_frames(strands[-1], scene)
    sequence = DrapeSequence(
        strands=_frames(strands),
        posed=_frames(posed),
        rest_lengths=groom.rest_lengths.numpy(),
        body_vertices=_frames(vertices),
        body_faces=body.faces.numpy().astype(np.int32),
        body_pose=motion.body_pose.numpy(),
        body_shape=body_shape.numpy(),
        fps=motion.fps,
        meta={
            "groom": groom.name,
            "licence": groom.licence,
            "motion": motion.name,
            "draper": draper.name,
            "version": version("quaffure"),
            "material": asdict(draper.material),
            "milliseconds": float(np.median(times[1:] or times)),
        },
        **{name: values.cpu().numpy() for name, values in held_parts_of(groom).items()},
    )
    return sequence if motion.translation is None else sequence.moved(motion.translation.numpy())


def bodies_of(sequence: DrapeSequence, body: BodyModel, frames: slice = slice(None)) -> BodyBatch:
    """The bodies of some frames of a drape, in place."""
    body_pose = torch.from_numpy(sequence.body_pose[frames])
    return BodyBatch(body, body_pose, torch.from_numpy(sequence.body_shape).expand(len(body_pose), -1))


def material_of(sequence: DrapeSequence) -> HairMaterial:
    """The material that a drape was made with; the default one where its file does not say.

    Raises:
        InputError: its file holds something else under that name.
    """
    with refused("meta of the drape", "the material of its hair", ValueError):
        return material_from(sequence.meta.get("material", {}))


def _frames(parts: list[torch.Tensor]) -> np.ndarray:
    return np.concatenate([part.detach().cpu().numpy() for part in parts])
