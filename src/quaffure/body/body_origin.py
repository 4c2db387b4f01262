"""Where an imported body comes from, and the way back to its file's space."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class BodyOrigin:
    """The character file of a body.

    A point x of the body at rest is `scale * rotation @ x + translation` in the file's scene; arms and legs are posed
    otherwise there.

    Attributes:
        scale: file units in a metre.
        rotation: a proper rotation, from the body's axes (z up, facing -y) to the file's.
        translation: [file units].
        source: name of the file.
        digest: its SHA-256.
        joint_nodes: for each joint of the body the node of the file that it is, an empty text for one that was placed
            between others.
    """

    scale: float
    rotation: Float[np.ndarray, "3 3"]
    translation: Float[np.ndarray, "3"]
    source: str
    digest: str
    joint_nodes: tuple[str, ...]

    def file_from_body(self, points: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
        """Points of the body's space [m] in the file's scene [file units]."""
        return self.scale * points.astype(np.float64) @ self.rotation.T + self.translation

    def body_from_file(self, points: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
        """Points of the file's scene [file units] in the body's space [m]."""
        return (points.astype(np.float64) - self.translation) @ self.rotation / self.scale
