"""A motion draped a few frames at a time."""

import time
from collections.abc import Callable
from dataclasses import asdict
from importlib.metadata import version
from typing import Any

import numpy as np
import torch
from jaxtyping import Float32, Int32

from quaffure.body.body_model import BodyModel
from quaffure.body.motion import Motion
from quaffure.body.pose_limits import Rows, shape_of
from quaffure.config import HairMaterial
from quaffure.draper import ClipDraper, Draper, ResumableDraper
from quaffure.errors import InputError, refused
from quaffure.file_values import material_from
from quaffure.frame_store import BatchState, Frames, FramesInMemory, FrameStore
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
    body_shape: Rows,
    on_frames: Callable[[Positions, Scene], None] = lambda draped, scene: None,
    continues: bool = False,
    store: FrameStore | None = None,
) -> DrapeSequence:
    """Drape the frames in their order, each by itself unless the draper follows from frame to frame.

    Frames are draped in place, where float32 is finest, and then moved along the path of the motion.

    Args:
        body_shape: beta [10], a tensor, an array or a list [standard deviations].
        on_frames: called with each batch of frames' drapes and scene, in place.
        continues: the frames follow those that the draper draped last, at its rate; otherwise the first is settled
            anew.
        store: keeps the frames, along the path of the motion; those that it holds already are not draped again, but
            passed to `on_frames`. In memory, where none is given.

    Raises:
        InputError: a groom, a motion or a shape that cannot be draped, or a store that holds other frames.

    Returns:
        The drapes. `meta` says what made them, and `milliseconds`, the median wall time of one drape, from pose in to
        strands out, in batches of `FRAMES_AT_ONCE`, the first batch left out where there are others.
    """
    store, shape = FramesInMemory() if store is None else store, shape_of(body_shape)
    if isinstance(draper, ClipDraper) and not continues:
        draper.restart()
        draper.frame_seconds = 1 / motion.fps
    stored = len(store)
    if stored:
        _check_stored(store, groom, body)
    for first in range(0, len(motion), FRAMES_AT_ONCE):
        rows = slice(first, min(first + FRAMES_AT_ONCE, len(motion)))
        start = time.perf_counter()
        body_pose = motion.body_pose[rows]
        offsets = None if motion.morphs is None else motion.morphs.offsets(rows)
        scene = Scene(groom, BodyBatch(body, body_pose, shape.expand(len(body_pose), -1), offsets))
        path = _path(motion, rows)
        if rows.stop <= stored:
            draped = torch.from_numpy(store.frames().strands[rows] - path[:, None, None])
            if rows.stop == stored and isinstance(draper, ResumableDraper) and store.draper_state is not None:
                draper.resume(scene, torch.from_numpy(store.draper_state))
        else:
            draped = draper.drape(scene).detach()
            milliseconds = 1000 * (time.perf_counter() - start) / len(body_pose)
            state = draper.state if isinstance(draper, ResumableDraper) else None
            store.append(
                _along_path(draped, scene, path),
                BatchState(milliseconds, None if state is None else state.numpy().astype(np.float32)),
            )
        on_frames(draped, scene)
    times = store.milliseconds[1:] or store.milliseconds
    made_by = {"draper": draper.name, "material": asdict(draper.material), "milliseconds": float(np.median(times))}
    return _sequence(store.frames(), groom, motion, shape, body.faces.numpy().astype(np.int32), made_by)


def _check_stored(store: FrameStore, groom: Groom, body: BodyModel) -> None:
    strands = tuple(groom.rest_strands.shape)
    expected = strands, strands, (len(body.rest_vertices), 3)
    for name, array, shape in zip(Frames._fields, store.frames(), expected):
        if array.shape[1:] != shape:
            raise InputError("frames of an interrupted drape", f"{name} of shape {shape}", f"{array.shape[1:]}")


def _along_path(draped: Positions, scene: Scene, path: Float32[np.ndarray, "f 3"]) -> Frames:
    """Frames of a batch, moved from their place along the path of the motion."""
    strands, posed, vertices = (
        positions.detach().cpu().numpy() for positions in (draped, scene.posed, scene.bodies.posed.vertices)
    )
    return Frames(strands + path[:, None, None], posed + path[:, None, None], vertices + path[:, None])


def _sequence(
    frames: Frames,
    groom: Groom,
    motion: Motion,
    body_shape: Float[Tensor, "10"],
    body_faces: Int32[np.ndarray, "k 3"],
    made_by: dict[str, Any],
) -> DrapeSequence:
    meta: dict[str, Any] = {"groom": groom.name, "licence": groom.licence, "motion": motion.name}
    meta["version"] = version("quaffure")
    if motion.start:
        meta["start"] = motion.start
    return DrapeSequence(
        strands=frames.strands,
        posed=frames.posed,
        rest_lengths=groom.rest_lengths.numpy(),
        body_vertices=frames.body_vertices,
        body_faces=body_faces,
        body_pose=motion.body_pose.numpy(),
        body_shape=body_shape.numpy(),
        fps=motion.fps,
        meta=meta | made_by,
        body_translation=None if motion.translation is None else motion.translation.numpy().astype(np.float32),
        **{name: values.cpu().numpy() for name, values in held_parts_of(groom).items()},
    )


def _path(motion: Motion, rows: slice) -> Float32[np.ndarray, "f 3"]:
    """Translation of the body in some frames [m]."""
    if motion.translation is None:
        return np.zeros((rows.stop - rows.start, 3), np.float32)
    return motion.translation[rows].numpy().astype(np.float32)


def bodies_of(sequence: DrapeSequence, body: BodyModel, frames: slice = slice(None)) -> BodyBatch:
    """The bodies of some frames of a drape, in place."""
    body_pose = torch.from_numpy(sequence.body_pose[frames])
    vertices = None
    if body.origin is not None:
        # Morph targets of its character may have changed the surface, of which a drape keeps the vertices alone.
        vertices = torch.from_numpy(np.asarray(sequence.body_vertices[frames], np.float32))
        path = sequence.body_translation
        if path is not None:
            vertices = vertices - torch.from_numpy(path[frames].astype(np.float32))[:, None]
    return BodyBatch(body, body_pose, torch.from_numpy(sequence.body_shape).expand(len(body_pose), -1), None, vertices)


def material_of(sequence: DrapeSequence) -> HairMaterial:
    """The material that a drape was made with; the default one where its file does not say.

    Raises:
        InputError: its file holds something else under that name.
    """
    with refused("meta of the drape", "the material of its hair", ValueError):
        return material_from(sequence.meta.get("material", {}))
