"""Body, hair, floor and lights in viser's scene."""

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy.spatial import cKDTree
from viser import ClientHandle, LineSegmentsHandle, ViserServer

from quaffure.apps.render.camera import AZIMUTHS
from quaffure.apps.viewer.hair_colours import KEY_LIGHT, segments
from quaffure.body.body_model import BodyModel
from quaffure.body.pose_features import HEAD
from quaffure.hair.groom import Groom

SKIN, SCALP = (205, 172, 150), (84, 56, 36)
TRANSLUCENT = 0.45  # opacity
FLOOR, FLOOR_LINES = (236, 236, 234), (205, 205, 203)
SCALP_RADIUS = 0.012  # m around a root: the scalp has the colour of hair
# Few strands stand for many and are drawn wider [m].
WIDEST_STRAND, WIDEST_COUNT, THINNEST_STRAND = 0.9e-3, 2400, 0.3e-3
# The camera: a long lens, far enough for head and chest.
FIELD_OF_VIEW, DISTANCE = np.radians(24.0), 1.75  # m
TARGET_BELOW_HEAD = 0.06  # m below the Head joint


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

    def move_camera(self, view: str, client: ClientHandle) -> None:
        """Move the camera of one browser to a view of `AZIMUTHS`."""
        with client.atomic():
            client.camera.up_direction = (0.0, 0.0, 1.0)
            client.camera.position = tuple(self._eye(AZIMUTHS[view]))
            client.camera.look_at = tuple(self._target())

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
        camera.position, camera.look_at = tuple(self._eye(AZIMUTHS["front"] + 20.0)), tuple(self._target())
        camera.fov, camera.near = float(FIELD_OF_VIEW), 0.02

    def _target(self) -> Float[np.ndarray, "3"]:
        return self._head - (0.0, 0.0, TARGET_BELOW_HEAD)

    def _eye(self, azimuth_deg: float) -> Float[np.ndarray, "3"]:
        azimuth = np.radians(azimuth_deg)
        return self._target() + DISTANCE * np.array([np.sin(azimuth), -np.cos(azimuth), 0.08])


def _thickness(strands: int) -> float:
    return max(THINNEST_STRAND, WIDEST_STRAND * min(1.0, (WIDEST_COUNT / strands) ** 0.5))
