"""A character's animation at any times: properties of its nodes between their keys.

Interpolation as in appendix C of the glTF 2.0 specification: before the first key and after the last, values stay.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from quaffure.body.character import (
    AnimationChannel,
    Character,
    CharacterAnimation,
    local_matrices,
    world_matrices,
)
from quaffure.errors import InputError
from quaffure.geometry.hermite import hermite, key_intervals

NODES_AT_ONCE = 2**16
"""Nodes of all frames that are computed together."""
MOST_NODES = 2**24  # in all frames; a clip takes about 150 bytes of each
SMALLEST_SINE = 1e-6
"""Sine of the angle between two quaternions; below it, the arc is a line."""


class CharacterPoses(NamedTuple):
    """A character in some frames.

    Attributes:
        world: `scene_from_node` of every node.
        morph_weights: of the meshes with morph targets, by the node that they hang on.
    """

    world: Float[np.ndarray, "f n 4 4"]
    morph_weights: dict[int, Float[np.ndarray, "f t"]]


def frame_times(animation: CharacterAnimation, fps: float, most: int) -> Float[np.ndarray, " f"]:
    """Times of the frames from an animation's first key to its last [s].

    Raises:
        InputError: more than `most` frames.
    """
    first, last = animation.span
    intervals = (last - first) * fps + 1e-3  # times in float32 end a rounding before a frame
    if not intervals < most:
        raise InputError(f"animation '{animation.name}'", f"at most {most} frames at {fps:g} fps", f"{intervals:.0f}")
    return first + np.arange(int(intervals) + 1) / fps


def poses_at(
    character: Character, animation: CharacterAnimation | None, times: Float[np.ndarray, " f"]
) -> Iterator[CharacterPoses]:
    """The character at times of an animation [s], or at rest without one; some frames after others.

    Raises:
        InputError: nodes that are scaled beyond any size, or too many of them in all frames.
    """
    if len(times) * len(character.nodes) > MOST_NODES:
        found = f"{len(character.nodes)} nodes in {len(times)} frames"
        raise InputError(character.source, f"at most {MOST_NODES} nodes in all frames", found)
    at_once = max(1, NODES_AT_ONCE // len(character.nodes))
    for first in range(0, len(times), at_once):
        yield _poses_at(character, animation, times[first : first + at_once])


def sampled(channel: AnimationChannel, times: Float[np.ndarray, " f"]) -> Float[np.ndarray, "f c"]:
    """Values of a channel at some times [s]; rotations as unit quaternions `xyzw`."""
    values = channel.values
    middle = values.shape[1] // 2
    before, after, seconds, share = key_intervals(channel.times, times)
    start, end = values[before, middle], values[after, middle]
    if channel.interpolation == "STEP":
        found = start
    elif channel.interpolation == "CUBICSPLINE":
        leaving, arriving = seconds[:, None] * values[before, 2], seconds[:, None] * values[after, 0]
        found = hermite(share[:, None], start, end, leaving, arriving)
    elif channel.path == "rotation":
        found = _slerp(_unit(start), _unit(end), share[:, None])
    else:
        found = start + share[:, None] * (end - start)
    return _unit(found) if channel.path == "rotation" else found


def _poses_at(
    character: Character, animation: CharacterAnimation | None, times: Float[np.ndarray, " f"]
) -> CharacterPoses:
    nodes, frames = character.nodes, len(times)
    properties = {
        name: np.repeat(getattr(nodes, name)[None], frames, axis=0) for name in ("translation", "rotation", "scale")
    }
    morphs = {
        mesh.node: np.repeat(np.array(mesh.morph_weights)[None], frames, axis=0)
        for mesh in character.meshes
        if mesh.morph_targets
    }
    for channel in animation.channels if animation is not None else ():
        if channel.path == "weights":
            morphs[channel.node] = sampled(channel, times)
        else:
            properties[channel.path][:, channel.node] = sampled(channel, times)
    world = world_matrices(nodes.parents, local_matrices(**properties))
    if not np.isfinite(world).all():
        raise InputError(character.source, "nodes within 1e300 of one another in every frame", "others")
    return CharacterPoses(world, morphs)


def _slerp(
    a: Float[np.ndarray, "f 4"], b: Float[np.ndarray, "f 4"], share: Float[np.ndarray, "f 1"]
) -> Float[np.ndarray, "f 4"]:
    """Spherical interpolation of unit quaternions along the shorter arc."""
    cosine = (a * b).sum(-1, keepdims=True)
    b = np.where(cosine < 0, -b, b)
    angle = np.arccos(np.clip(np.abs(cosine), 0, 1))
    sine = np.sin(angle)
    is_short = sine < SMALLEST_SINE
    divisor = np.where(is_short, 1, sine)
    first = np.where(is_short, 1 - share, np.sin((1 - share) * angle) / divisor)
    return first * a + np.where(is_short, share, np.sin(share * angle) / divisor) * b


def _unit(quaternion: Float[np.ndarray, "f 4"]) -> Float[np.ndarray, "f 4"]:
    """Scaled to length 1; a spline that passes zero has no direction there and gives the identity."""
    length = np.linalg.norm(quaternion, axis=-1, keepdims=True)
    identity = np.array([0.0, 0.0, 0.0, 1.0])
    return np.where(length > 1e-9, quaternion / np.maximum(length, 1e-9), identity)
