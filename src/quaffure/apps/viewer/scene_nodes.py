"""Body, hair, floor and lights in viser's scene."""

from weakref import WeakKeyDictionary

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy.spatial import cKDTree
from viser import ClientHandle, LineSegmentsHandle, ViserServer

from quaffure.apps.render.camera import AZIMUTHS
from quaffure.apps.viewer.hair_colours import KEY_LIGHT, segments
from quaffure.body.body_model import BodyModel
from quaffure.body.pose_features import HEAD
from quaffure.hair.groom import Groom

Point = tuple[float, float, float]

SKIN, SCALP = (205, 172, 150), (84, 56, 36)
TRANSLUCENT = 0.45  # opacity
FLOOR, FLOOR_LINES = (236, 236, 234), (205, 205, 203)
SCALP_RADIUS = 0.012  # m around a root: the scalp has the colour of hair
# Few strands stand for many and are drawn wider [m].
WIDEST_STRAND, WIDEST_COUNT, THINNEST_STRAND = 0.9e-3, 2400, 0.3e-3
# The camera: a long lens, far enough for head and chest.
FIELD_OF_VIEW, DISTANCE = np.radians(24.0), 1.75  # m
TARGET_BELOW_HEAD = 0.06  # m below the Head joint
FIRST_VIEW = AZIMUTHS["front"] + 20.0  # degrees
# A picture higher than wide shows this much from side to side [m]: head, hair and shoulders.
LEAST_WIDTH = 0.5
# In a narrow window viser's panel covers up to 0.6 of the picture from below. Browsers send the size of the picture in
# pixels of the screen, which are smaller than those that viser decides by, so only the shape of the window is known.
PORTRAIT = 1.15  # height of the picture, in widths
SAME_PLACE = 1e-3  # m
HEAD_ABOVE_PANEL = 0.19  # of the height of the picture, how far the head is above its middle
CROWN = 0.29  # m, of the hair on it above the target


class SceneNodes:
    """Nodes of body and hair. They are the same in all browsers; each has a camera of its own."""

    def __init__(self, server: ViserServer, body: BodyModel) -> None:
        self._server, self._body = server, body
        self._head = body.rest_joints[body.joint_names.index(HEAD)].numpy().astype(float)
        self._faces = body.faces.numpy()
        self._scalp_vertices: Int[np.ndarray, " v"] = np.unique(self._faces[body.scalp.faces.numpy()])
        vertices = body.rest_vertices.numpy()
        self._skin = server.scene.add_mesh_simple("/body/skin", vertices, self._faces, color=SKIN)
        self._scalp = server.scene.add_mesh_simple("/body/scalp", vertices, self._faces[:1], color=SCALP)
        self._hair: LineSegmentsHandle | None = None
        self._placed: WeakKeyDictionary[ClientHandle, tuple[float, Point]] = WeakKeyDictionary()
        self._add_surroundings()

    def set_groom(self, groom: Groom) -> None:
        """Give the scalp under a groom the colour of hair."""
        covered = self._covered(groom)
        self._scalp_vertices, faces = np.unique(self._faces[covered], return_inverse=True)
        with self._server.atomic():
            self._skin.faces = self._faces[~covered].astype(np.uint32)
            self._scalp.vertices = self._body.rest_vertices.numpy()[self._scalp_vertices]
            self._scalp.faces = faces.reshape(-1, 3).astype(np.uint32)

    def show(
        self,
        body_vertices: Float[np.ndarray, "v 3"],
        strands: Float[np.ndarray, "s n 3"],
        colours: UInt8[np.ndarray, "s n 3"],
        path: Float[np.ndarray, "3"],
    ) -> None:
        """Draw a drape. Nodes are kept and get new points.

        Args:
            path: of the body [m]. The floor moves instead of the body, so that every browser's camera travels with it.
        """
        step = path.astype(np.float32)
        body_vertices, strands = body_vertices - step, strands - step
        points, ends = segments(strands), segments(colours)
        with self._server.atomic():
            # The grid repeats itself every metre: it need not move further.
            self._floor.position = tuple(-np.fmod(path, 1.0))
            self._skin.vertices = body_vertices
            self._scalp.vertices = body_vertices[self._scalp_vertices]
            if self._hair is None or self._hair.points.shape != points.shape:
                self._hair = self._server.scene.add_line_segments(
                    "/hair", points, ends, thickness=_thickness(len(strands))
                )
            else:
                self._hair.points, self._hair.colors = points, ends

    def set_translucent(self, body_is_translucent: bool) -> None:
        """Show what is inside the body, or hide it."""
        with self._server.atomic():
            self._skin.opacity = self._scalp.opacity = TRANSLUCENT if body_is_translucent else None

    def move_camera(self, azimuth_deg: float, client: ClientHandle) -> None:
        """Move the camera of one browser to a side of the head.

        Args:
            azimuth_deg: from the face (-y) towards the body's left (+x).
        """
        camera = client.camera
        eye, target = self._framing(azimuth_deg, camera.image_width, camera.image_height)
        self._placed[client] = azimuth_deg, eye
        with client.atomic():
            camera.up_direction = (0.0, 0.0, 1.0)
            camera.position, camera.look_at = eye, target

    def fit_camera(self, client: ClientHandle) -> None:
        """Move a camera to where the window, which may have changed, shows head and hair; leave one that a user or a
        link has moved. Browsers report viser's own camera first, and then that of this scene."""
        camera = client.camera
        azimuth, placed = self._placed.get(client, (FIRST_VIEW, self._first_eye))
        eye, _ = self._framing(azimuth, camera.image_width, camera.image_height)
        if np.allclose(camera.position, placed, atol=SAME_PLACE) and not np.allclose(eye, placed, atol=SAME_PLACE):
            self.move_camera(azimuth, client)

    def _covered(self, groom: Groom) -> Bool[np.ndarray, " k"]:
        """Faces of the body at or near the roots."""
        roots = cKDTree(groom.rest_strands[:, 0].numpy())
        near = np.isfinite(roots.query(self._body.rest_vertices.numpy(), distance_upper_bound=SCALP_RADIUS)[0])
        covered = near[self._faces].all(axis=1)
        covered[groom.root_faces.numpy()] = True
        return covered

    def _add_surroundings(self) -> None:
        scene, camera = self._server.scene, self._server.initial_camera
        scene.configure_default_lights(enabled=False)
        scene.configure_environment_map(hdri=None)
        scene.add_light_hemisphere("/light/sky", sky_color=(255, 252, 246), ground_color=(150, 140, 132), intensity=1.4)
        scene.add_light_directional("/light/key", intensity=2.2, position=KEY_LIGHT)
        scene.add_light_directional("/light/fill", intensity=0.7, position=(0.8, -0.5, 0.2))
        scene.add_light_directional("/light/rim", intensity=0.9, position=(0.3, 0.9, 0.6))
        self._floor = scene.add_grid(
            "/floor", 6.0, 6.0, cell_color=FLOOR_LINES, section_color=FLOOR_LINES, plane_color=FLOOR, plane_opacity=1.0
        )
        self._first_eye, camera.look_at = self._framing(FIRST_VIEW, 1, 1)
        camera.position = self._first_eye
        camera.fov, camera.near = float(FIELD_OF_VIEW), 0.02

    def _framing(self, azimuth_deg: float, width: int, height: int) -> tuple[Point, Point]:
        """Position of a camera at one side of the head, and the point in the middle of its picture [m].

        Args:
            width, height: of the picture [pixels].
        """
        azimuth = np.radians(azimuth_deg)
        rise = HEAD_ABOVE_PANEL if is_portrait(width, height) else 0.0
        shown_height = max(
            2.0 * DISTANCE * np.tan(0.5 * FIELD_OF_VIEW), LEAST_WIDTH * height / max(width, 1), CROWN / (0.5 - rise)
        )
        distance = 0.5 * shown_height / np.tan(0.5 * FIELD_OF_VIEW)
        target = self._head - (0.0, 0.0, TARGET_BELOW_HEAD + rise * shown_height)
        eye = target + distance * np.array([np.sin(azimuth), -np.cos(azimuth), 0.08])
        return _point(eye), _point(target)


def is_portrait(width: int, height: int) -> bool:
    """Whether a picture of this size is likely to have the panel over its lower half, and not beside it."""
    return height > PORTRAIT * width


def _point(vector: np.ndarray) -> Point:
    return float(vector[0]), float(vector[1]), float(vector[2])


def _thickness(strands: int) -> float:
    return max(THINNEST_STRAND, WIDEST_STRAND * min(1.0, (WIDEST_COUNT / strands) ** 0.5))
