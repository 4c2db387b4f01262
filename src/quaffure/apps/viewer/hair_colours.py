"""Colours of strands, with shading, for a viewer that draws lines without light."""

from functools import cache

import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8

# three.js takes the colours of lines as linear RGB, unlike those of meshes.
BROWN = (0.19, 0.085, 0.036)  # linear RGB
INSIDE = (255, 0, 20)
PALE = 0.8  # how far hair fades to grey where vertices inside the body are shown
# Directions towards the lights: over the body's right shoulder in front, and low behind its left.
KEY_LIGHT, FILL_LIGHT = (-0.5, -0.7, 0.75), (0.7, 0.6, 0.2)
# Halfway between the key light and a viewer in front.
HALFWAY = (-0.27, -0.88, 0.40)
SHININESS = 40


def hair_colours(
    strands: Float[np.ndarray, "s n 3"], inside: Bool[np.ndarray, "s n"] | None = None
) -> UInt8[np.ndarray, "s n 3"]:
    """Linear RGB of every vertex: brown, a little different for each strand, shaded by its tangent (Kajiya and Kay
    1989) and by its side of the head, darker at the roots.

    Args:
        strands: vertices in the world, roots first [m].
        inside: vertices to mark; with it, all other hair is paler.
    """
    tangent = _unit(np.gradient(strands, axis=1))
    outwards = _unit(strands - strands[:, 0].mean(axis=0))
    key, fill = _unit(np.array(KEY_LIGHT, np.float32)), _unit(np.array(FILL_LIGHT, np.float32))
    along = _across(tangent, key) * (0.66 + 0.34 * (outwards @ key)) + 0.3 * _across(tangent, fill) * (
        0.6 + 0.4 * (outwards @ fill)
    )
    shine = _across(tangent, _unit(np.array(HALFWAY, np.float32))) ** SHININESS
    from_root = np.linspace(0, 1, strands.shape[1], dtype=np.float32)
    brightness = (0.16 + 1.1 * along**1.5) * (0.5 + 0.5 * np.sqrt(from_root))
    colours = _strand_tints(len(strands))[:, None] * brightness[..., None] + 0.06 * (shine * from_root)[..., None]
    if inside is not None:
        colours += PALE * (1.5 * colours.mean(axis=-1, keepdims=True) - colours)
    shaded = (255 * np.clip(colours, 0, 1)).astype(np.uint8)
    if inside is not None:
        shaded[inside] = INSIDE
    return shaded


def segments(values: np.ndarray) -> np.ndarray:
    """Both ends of every segment, [s, n, 3] to [s (n - 1), 2, 3]."""
    return np.stack([values[:, :-1], values[:, 1:]], axis=2).reshape(-1, 2, 3)


@cache
def _strand_tints(count: int) -> Float32[np.ndarray, "s 3"]:
    """Brown, some strands darker and some with more red; the same at every call."""
    generator = np.random.default_rng(0)
    darker = 1 + 0.16 * generator.standard_normal((count, 1)).clip(-2, 2)
    redder = 1 + 0.05 * generator.standard_normal((count, 1)).clip(-2, 2) * np.array([1.0, 0.0, -1.0])
    return (np.array(BROWN) * darker * redder).astype(np.float32)


def _across(tangent: Float[np.ndarray, "s n 3"], direction: Float[np.ndarray, "3"]) -> Float[np.ndarray, "s n"]:
    """Sine of the angle between hair and light: hair across the light is bright, hair along it dark."""
    return np.sqrt(np.clip(1 - (tangent @ direction) ** 2, 0, 1))


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9).astype(vectors.dtype)
