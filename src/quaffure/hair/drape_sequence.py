"""A drape over time, as files, pictures, videos and metrics take it."""

from dataclasses import dataclass, field, replace
from importlib import import_module
from typing import Any

import numpy as np
from jaxtyping import Float, Float32, Int, Int32

LAST_SECOND = 1e6
"""Latest time at which a motion may start in its file."""


@dataclass(frozen=True)
class DrapeSequence:
    """Draped hair of every frame, with the body under it. World frame, z up, the body faces -y.

    Attributes:
        strands: draped vertices, roots first [m].
        posed: the same strands moved rigidly with the scalp, before draping [m].
        rest_lengths: length of every segment at rest [m].
        body_vertices: surface of the posed body [m].
        body_faces: triangles, counter-clockwise seen from outside.
        body_pose: 27 joints x 3 axis-angle components, theta [rad].
        body_shape: coefficients of the shape basis, beta [-].
        fps: frames per second.
        meta: groom, draper, version, parameters; anything that JSON holds.
        stiffness_scale, goal_weight, tie_vertex: of the groom, where it has them (`Groom`).
        body_translation: of the body from its rest position [m], in all positions above; None where it stays in place.
    """

    strands: Float32[np.ndarray, "f s n 3"]
    posed: Float32[np.ndarray, "f s n 3"]
    rest_lengths: Float[np.ndarray, "s e"]
    body_vertices: Float[np.ndarray, "f v 3"]
    body_faces: Int32[np.ndarray, "k 3"]
    body_pose: Float[np.ndarray, "f 81"]
    body_shape: Float[np.ndarray, "10"]
    fps: float
    meta: dict[str, Any] = field(default_factory=dict)
    stiffness_scale: Float[np.ndarray, "s e"] | None = None
    goal_weight: Float[np.ndarray, "s e"] | None = None
    tie_vertex: Int[np.ndarray, " s"] | None = None
    body_translation: Float[np.ndarray, "f 3"] | None = None

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.strands)

    def _repr_html_(self) -> str:
        """A small picture, for notebooks."""
        # By name: the renderer is above this package, and only a notebook asks for a picture.
        return str(import_module("quaffure.apps.notebook").html_of_drape(self))

    @property
    def times(self) -> Float[np.ndarray, " f"]:
        """Times of the frames in the file of the motion [s]; from 0 where `meta` does not say when it starts."""
        start = self.meta.get("start", 0.0)
        known = type(start) in (int, float) and abs(start) <= LAST_SECOND
        return (float(start) if known else 0.0) + np.arange(len(self)) / self.fps

    def in_place(self) -> "DrapeSequence":
        """The drape as seen from a camera that moves with the body: without its translation."""
        return self if self.body_translation is None else self._moved(-self.body_translation)

    def moved(self, translation: Float[np.ndarray, "f 3"]) -> "DrapeSequence":
        """The drape of a body that stays in place, translated along a path [m]."""
        assert self.body_translation is None
        return replace(self._moved(translation), body_translation=translation.astype(np.float32))

    def _moved(self, translation: Float[np.ndarray, "f 3"]) -> "DrapeSequence":
        step = translation.astype(np.float32)
        return replace(
            self,
            strands=self.strands + step[:, None, None],
            posed=self.posed + step[:, None, None],
            body_vertices=self.body_vertices + step[:, None],
            body_translation=None,
        )
