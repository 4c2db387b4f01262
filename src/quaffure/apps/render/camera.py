"""A pinhole camera on a circle around the head."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

# A long lens: close cameras make noses and foreheads look larger.
FIELD_OF_VIEW = np.radians(22.0)


@dataclass(frozen=True)
class Camera:
    """A pinhole camera looking at a point; up is world z.

    Attributes:
        eye: position of the camera [m].
        target: the point in the middle of the picture [m].
        field_of_view: of the shorter side of the picture [rad].
    """

    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    field_of_view: float = float(FIELD_OF_VIEW)

    @staticmethod
    def around(
        centre: Sequence[float] | np.ndarray, extent: float, azimuth_deg: float, rise_deg: float = 4.0
    ) -> "Camera":
        """A camera that fits `extent` metres around `centre` into the picture's shorter side.

        Args:
            azimuth_deg: 0 in front of the face (-y); 90 at the body's left hand (+x); 180 behind.
            rise_deg: elevation of the camera above the horizon of `centre`.
        """
        azimuth, rise = np.radians(azimuth_deg), np.radians(rise_deg)
        distance = 0.5 * extent / np.tan(0.5 * FIELD_OF_VIEW) + 0.25 * extent
        outwards = np.array([np.cos(rise) * np.sin(azimuth), -np.cos(rise) * np.cos(azimuth), np.sin(rise)])
        target = np.asarray(centre, dtype=np.float64)
        eye = target + distance * outwards
        return Camera(_triple(eye), _triple(target))

    @staticmethod
    def front(centre: Sequence[float] | np.ndarray, extent: float, facing_deg: float = 0.0) -> "Camera":
        """In front of a body rotated by `facing_deg` about the vertical; at -y for 0."""
        return Camera.around(centre, extent, facing_deg)

    @staticmethod
    def three_quarter(centre: Sequence[float] | np.ndarray, extent: float, facing_deg: float = 0.0) -> "Camera":
        """Half way between front and side."""
        return Camera.around(centre, extent, facing_deg + 40.0)

    @staticmethod
    def side(centre: Sequence[float] | np.ndarray, extent: float, facing_deg: float = 0.0) -> "Camera":
        """From the body's left, +x; the face points to the left of the picture."""
        return Camera.around(centre, extent, facing_deg + 90.0)

    @staticmethod
    def back(centre: Sequence[float] | np.ndarray, extent: float, facing_deg: float = 0.0) -> "Camera":
        """From behind, +y."""
        return Camera.around(centre, extent, facing_deg + 180.0)

    @property
    def camera_from_world(self) -> Float[np.ndarray, "4 4"]:
        """Rigid transform; the camera looks along its -z, y up, x to the right."""
        return look_at(np.array(self.eye), np.array(self.target))

    def clip_from_world(self, width: int, height: int, radius: float) -> Float[np.ndarray, "4 4"]:
        """Perspective projection to OpenGL clip space of a scene within `radius` [m] of the target."""
        distance = float(np.linalg.norm(np.subtract(self.eye, self.target)))
        near, far = max(distance - radius, 0.02 * distance), distance + radius
        scale = 1.0 / np.tan(0.5 * self.field_of_view)
        shorter = min(width, height)
        projection = np.zeros((4, 4))
        projection[0, 0], projection[1, 1] = scale * shorter / width, scale * shorter / height
        projection[2, 2:] = (near + far) / (near - far), 2.0 * near * far / (near - far)
        projection[3, 2] = -1.0
        return projection @ self.camera_from_world


def look_at(eye: np.ndarray, target: np.ndarray) -> Float[np.ndarray, "4 4"]:
    """Transform to the frame of an observer at `eye` who looks along -z at `target`, world z upwards."""
    backwards = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross([0.0, 0.0, 1.0], backwards)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, :3] = right, np.cross(backwards, right), backwards
    matrix[:3, 3] = -matrix[:3, :3] @ eye
    return matrix


def _triple(vector: np.ndarray) -> tuple[float, float, float]:
    return float(vector[0]), float(vector[1]), float(vector[2])
