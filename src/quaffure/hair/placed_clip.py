"""A drape as other programs take it, in the scene of the character that its body was imported from."""

from dataclasses import dataclass, field, fields
from functools import cached_property

import numpy as np
from jaxtyping import Float, Float32, Int, Int32

from quaffure.errors import InputError
from quaffure.hair.character_space import BoundPoints, CharacterSpace
from quaffure.hair.export_clip import ExportClip

Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""From glTF's axes, y up, to those that writers of z up convert from."""


@dataclass(frozen=True)
class PlacedClip(ExportClip):
    """A clip whose strands and body are in a character's file [file units].

    The body is the file's own skin, in its own animation; in another motion it is the body that collides with hair.

    Attributes:
        inner: the clip in the world of the drape [m].
        space: the way from there to the file.
        is_z_up: whether the file's axes are turned, (x, y, z) to (x, -z, y), for writers that turn them back.
    """

    inner: ExportClip = field(kw_only=True)
    space: CharacterSpace = field(kw_only=True)
    is_z_up: bool = field(default=False, kw_only=True)

    @property
    def up_axis(self) -> str:
        return "z" if self.is_z_up else "y"

    @property
    def start(self) -> float:
        return self.space.start

    @property
    def times(self) -> Float32[np.ndarray, " f"]:
        return (self.inner.times + self.start).astype(np.float32)

    def points(self, frame: int) -> Float32[np.ndarray, "v 3"]:
        return self._turned(self.space.placed(self.inner.points(frame), self.counts, self._roots, frame))

    @cached_property
    def rest_points(self) -> Float32[np.ndarray, "v 3"]:
        return self._turned(self.space.origin.file_from_body(self.inner.rest_points))

    def strands(self, frame: int) -> Float32[np.ndarray, "m p 3"]:
        return self._placed_rows(self.inner.strands(frame), self._roots, frame)

    def guides(self, frame: int) -> Float32[np.ndarray, "g p 3"]:
        return self._placed_rows(self.inner.guides(frame), self._guide_roots, frame)

    @property
    def rest_guides(self) -> Float32[np.ndarray, "g p 3"]:
        return self._turned(self.space.origin.file_from_body(self.inner.rest_guides))

    @cached_property
    def root_uv(self) -> Float32[np.ndarray, "m 2"] | None:
        return self._uv_at(self._roots, self.inner.root_uv)

    @cached_property
    def guide_root_uv(self) -> Float32[np.ndarray, "g 2"] | None:
        return self._uv_at(self._guide_roots, self.inner.guide_root_uv)

    @property
    def strand_width(self) -> Float32[np.ndarray, " p"]:
        return (self.space.origin.scale * self.inner.strand_width).astype(np.float32)

    @cached_property
    def widths(self) -> Float32[np.ndarray, " v"]:
        return (self.space.origin.scale * self.inner.widths).astype(np.float32)

    def body_vertices(self, frame: int) -> Float32[np.ndarray, "v 3"]:
        if self.space.skin is None:
            return self._turned(self.space.origin.file_from_body(np.asarray(self.inner.body_vertices(frame))))
        return self._turned(self.space.skin.vertices(frame))

    @property
    def body_faces(self) -> Int32[np.ndarray, "k 3"]:
        return self.inner.body_faces if self.space.skin is None else self.space.skin.mesh.faces.astype(np.int32)

    @property
    def body_uv(self) -> Float32[np.ndarray, "k 3 2"] | None:
        if self.space.skin is None:
            return self.inner.body_uv
        mesh = self.space.skin.mesh
        # glTF counts v from the top of the image.
        return None if mesh.uv is None else (mesh.uv * [1, -1] + [0, 1])[mesh.faces].astype(np.float32)

    def file_arrays(self) -> dict[str, np.ndarray]:
        """What a drape file holds of the way to the character's file, for every vertex x of a strand and frame:
        `file_scale * file_rotation @ x + file_translation + root_offset`."""
        origin, sequence = self.space.origin, self.sequence
        arrays = {
            "file_scale": np.array(origin.scale),
            "file_rotation": origin.rotation,
            "file_translation": origin.translation,
            "file_start": np.array(self.start),
        }
        rest = sequence.posed[0] if self.binding is None else self.binding.strands
        roots = self.space.bound(np.asarray(rest)[:, 0])
        if roots is not None and self.space.skin is not None:
            arrays["root_offset"] = np.stack(
                [
                    self.space.skin.positions(roots, frame) - origin.file_from_body(sequence.strands[frame, :, 0])
                    for frame in range(len(sequence))
                ]
            ).astype(np.float32)
        return arrays

    def _uv_at(
        self, roots: BoundPoints | None, inner: Float32[np.ndarray, "r 2"] | None
    ) -> Float32[np.ndarray, "r 2"] | None:
        """Texture coordinates of the file's skin at roots, where the strands' source has none."""
        uv = self.body_uv
        if roots is None or uv is None or self._attributes.root_uv is not None:
            return inner
        return (roots.barycentric[..., None] * uv[roots.faces]).sum(axis=1).astype(np.float32)

    @cached_property
    def _roots(self) -> BoundPoints | None:
        return self.space.bound(self.inner.rest_points[np.cumsum(self.counts) - self.counts])

    @cached_property
    def _guide_roots(self) -> BoundPoints | None:
        return self.space.bound(self.inner.rest_guides[:, 0])

    def _placed_rows(
        self, strands: Float32[np.ndarray, "m p 3"], roots: BoundPoints | None, frame: int
    ) -> Float32[np.ndarray, "m p 3"]:
        counts: Int[np.ndarray, " m"] = np.full(len(strands), strands.shape[1])
        return self._turned(self.space.placed(strands.reshape(-1, 3), counts, roots, frame)).reshape(strands.shape)

    def _turned(self, points: Float[np.ndarray, "*v 3"]) -> Float32[np.ndarray, "*v 3"]:
        return (points @ Z_UP.T if self.is_z_up else points).astype(np.float32)


def placed_clip(clip: ExportClip, space: CharacterSpace) -> PlacedClip:
    """A clip of the drape's world in the scene of a character, which stays in place where the drape does.

    Raises:
        InputError: the drape is of another body, or of a groom that is not known: where roots are at rest is open.
    """
    if clip.binding is None:
        raise InputError("the drape", "one of the body that was imported from the character", "another body")
    if clip.sequence.body_translation is None:  # every motion of a character's own file has a path
        space = space.in_place()
    own = {each.name: getattr(clip, each.name) for each in fields(ExportClip)}
    return PlacedClip(**own, inner=clip, space=space)
