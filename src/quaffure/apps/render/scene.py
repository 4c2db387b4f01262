"""Pictures of hair on a body, drawn off screen with OpenGL (a GPU or Mesa's software rasteriser)."""

import math
from typing import Any

import moderngl
import numpy as np
from jaxtyping import Float, Int, UInt8
from PIL import Image
from scipy.spatial import cKDTree

from quaffure.apps.render.camera import Camera
from quaffure.apps.render.framing import hair_box
from quaffure.apps.render.key_light import KeyLight
from quaffure.apps.render.shaders import Uniforms, assign, build_program
from quaffure.errors import InputError
from quaffure.hair.strand_width import width_of

CHESTNUT = (0.15, 0.062, 0.025)
CLAY = (0.64, 0.475, 0.385)
SCALP_RADIUS = 0.012  # m, around a root
# Where roots are further apart, the radius is so many of their distances, up to a limit [m]: no spots between them.
RADIUS_OF_SPACING, LARGEST_SCALP_RADIUS = 2.2, 0.04
SHADOW_MARGIN = 0.1  # m, around hair and head: shadow falls on the body up to there
MOST_SAMPLES = 3  # of a segment, where strands are curly
ANGLE_OF_SAMPLE = math.radians(9.0)
LEAST_SAMPLES_ACROSS = 0.8
POINTS_PER_ROW = 2048
# Directions towards the lights in the camera's frame: right, up, towards the viewer.
KEY_LIGHT, FILL_LIGHT, RIM_LIGHT = (-0.5, 0.75, 0.6), (0.8, 0.1, 0.6), (0.3, 0.6, -0.7)
COLOUR, DEPTH = 0, 1


class StrandRenderer:
    """Draws strands and a body, off screen.

    Args:
        width, height: of the picture [pixels].
        strand_width: of one drawn ribbon [m]; without it, `width_of` the strands in the picture.
        supersampling: samples along each side of a pixel. Multisampling costs as much in software, and shades ribbons
            thinner than a pixel outside of their edges.

    Raises:
        InputError: no OpenGL context can be made on this machine.
    """

    def __init__(self, width: int, height: int, strand_width: float | None = None, supersampling: int = 4) -> None:
        self.width, self.height = width, height
        self.strand_width, self.supersampling = strand_width, supersampling
        self._gl = _create_context()
        size = (supersampling * width, supersampling * height)
        self._picture = self._gl.framebuffer([self._gl.renderbuffer(size, 4)], self._gl.depth_renderbuffer(size))
        self._key = KeyLight(self._gl)
        # The first of each pair of programs, COLOUR, writes colour; the second one, DEPTH, writes depth alone.
        self._hair = [build_program(self._gl, "hair", fragment) for fragment in ("hair", "depth")]
        self._body = [build_program(self._gl, "body", fragment) for fragment in ("body", "depth")]
        self._background = self._gl.vertex_array(build_program(self._gl, "background", "background"), [])
        self._hair_arrays = [self._gl.vertex_array(program, []) for program in self._hair]
        self._uploaded: list[moderngl.Texture | moderngl.Buffer | moderngl.VertexArray] = []

    def __enter__(self) -> "StrandRenderer":
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def release(self) -> None:
        """Free the OpenGL context and all it holds."""
        self._gl.release()

    def render(
        self,
        strands: Float[np.ndarray, "s n 3"],
        body_vertices: Float[np.ndarray, "v 3"],
        body_faces: Int[np.ndarray, "k 3"],
        camera: Camera,
        hair_colour: tuple[float, float, float] = CHESTNUT,
    ) -> UInt8[np.ndarray, "h w 3"]:
        """One picture, sRGB, first row on top.

        Args:
            strands: vertices in the world, roots first [m].
            body_vertices, body_faces: the body's surface [m]; faces counter-clockwise seen from outside.
            hair_colour: albedo in linear RGB.
        """
        lowest, highest = hair_box(strands, body_vertices)
        reach = np.linalg.norm(np.vstack([body_vertices, lowest, highest]) - np.array(camera.target), axis=1).max()
        with self._gl:  # another renderer's context may be current
            while self._uploaded:
                self._uploaded.pop().release()
            self._upload_strands(strands)
            self._upload_body(body_vertices, body_faces, strands[:, 0])
            lights = self._light(camera, lowest.astype(np.float64), highest.astype(np.float64))
            # After the shadow maps, which are drawn by the camera of the key light.
            uniforms = lights | self._camera_uniforms(camera, 1.1 * float(reach))
            for program in (*self._hair, *self._body):
                assign(program, hair_colour=hair_colour, body_colour=CLAY, **self._strand_uniforms, **uniforms)
            self._draw_picture()
            return self._read_pixels()

    def _upload_strands(self, strands: np.ndarray) -> None:
        count, vertices = strands.shape[:2]
        rows = -(-count * vertices // POINTS_PER_ROW)
        packed = np.zeros((rows * POINTS_PER_ROW, 3), dtype=np.float32)
        packed[: count * vertices] = strands.reshape(-1, 3)
        points = self._gl.texture((POINTS_PER_ROW, rows), 3, packed, dtype="f4")
        points.filter = (moderngl.NEAREST, moderngl.NEAREST)
        points.use(0)
        self._uploaded.append(points)
        self._strands, self._vertices, self._samples = count, vertices, (vertices - 1) * samples_of(strands) + 1
        self._strand_uniforms: Uniforms = {
            "points": 0,
            "strand_vertices": vertices,
            "samples": self._samples,
            "strand_width": self.strand_width or width_of(count),
        }

    def _upload_body(self, vertices: np.ndarray, faces: np.ndarray, roots: np.ndarray) -> None:
        cover = hair_cover(vertices, roots)[:, None]
        packed = np.hstack([vertices, vertex_normals(vertices, faces), cover]).astype(np.float32)
        buffer = self._gl.buffer(packed)
        indices = self._gl.buffer(np.ascontiguousarray(faces, dtype=np.int32))
        self._body_arrays = [
            self._gl.vertex_array(self._body[COLOUR], [(buffer, "3f 3f 1f", "position", "normal", "scalp")], indices),
            self._gl.vertex_array(self._body[DEPTH], [(buffer, "3f 4x4", "position")], indices),
        ]
        self._uploaded += [buffer, indices, *self._body_arrays]

    def _light(self, camera: Camera, lowest: np.ndarray, highest: np.ndarray) -> Uniforms:
        """Place the lights with the camera, key at its upper left, fill right, rim behind, and draw the shadow maps."""
        world_from_camera = camera.camera_from_world[:3, :3].T
        key, fill, rim = (world_from_camera @ _unit(light) for light in (KEY_LIGHT, FILL_LIGHT, RIM_LIGHT))
        self._key.place(key, lowest - SHADOW_MARGIN, highest + SHADOW_MARGIN)
        self._key.draw_maps(self._body_arrays[DEPTH], self._strands, self._vertices)
        return {**self._key.use(), "fill_direction": fill, "rim_direction": rim}

    def _camera_uniforms(self, camera: Camera, reach: float) -> Uniforms:
        angle = 2.0 * math.tan(0.5 * camera.field_of_view) / (self.supersampling * min(self.width, self.height))
        clip_from_world = camera.clip_from_world(self.width, self.height, reach)
        return {"eye": camera.eye, "clip_from_world": clip_from_world, "sample_angle": LEAST_SAMPLES_ACROSS * angle}

    def _draw_picture(self) -> None:
        target = self._picture
        target.use()
        target.depth_mask, target.color_mask = True, (True, True, True, True)
        target.clear()
        self._gl.disable(moderngl.DEPTH_TEST)
        self._background.render(moderngl.TRIANGLES, vertices=3)
        self._gl.enable(moderngl.DEPTH_TEST)
        # Dozens of strands cover a pixel. Depth comes first, so that only the nearest is shaded: several times faster.
        target.color_mask = False, False, False, False
        self._draw_surfaces(DEPTH)
        target.depth_mask, target.color_mask = False, (True, True, True, True)
        self._gl.depth_func = "<="
        self._draw_surfaces(COLOUR)

    def _draw_surfaces(self, kind: int) -> None:
        self._body_arrays[kind].render(moderngl.TRIANGLES)
        self._hair_arrays[kind].render(moderngl.TRIANGLE_STRIP, vertices=2 * self._samples, instances=self._strands)

    def _read_pixels(self) -> np.ndarray:
        size = (self.supersampling * self.width, self.supersampling * self.height)
        raw = Image.frombytes("RGB", size, self._picture.read(components=3))
        return np.asarray(raw.reduce(self.supersampling).transpose(Image.Transpose.FLIP_TOP_BOTTOM))


def samples_of(strands: Float[np.ndarray, "s n 3"]) -> int:
    """Straight parts to draw a segment in, so that curls look round; by the angles in a tenth of the strands."""
    edges = np.diff(strands[::10], axis=1)
    edges /= np.maximum(np.linalg.norm(edges, axis=-1, keepdims=True), 1e-9)
    angles = np.arccos(np.clip((edges[:, 1:] * edges[:, :-1]).sum(-1), -1.0, 1.0))
    largest = float(np.quantile(angles, 0.9)) if angles.size else 0.0
    return int(np.clip(math.ceil(largest / ANGLE_OF_SAMPLE), 1, MOST_SAMPLES))


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> Float[np.ndarray, "v 3"]:
    """Unit normals of vertices: face normals weighted by area."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    face = np.cross(b - a, c - a)
    index, weights = faces.reshape(-1), np.repeat(face, 3, axis=0)
    total = np.stack([np.bincount(index, weights[:, axis], minlength=len(vertices)) for axis in range(3)], axis=1)
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)


def hair_cover(vertices: np.ndarray, roots: np.ndarray) -> Float[np.ndarray, " v"]:
    """Share of scalp colour of each body vertex: 1 next to a root, 0 farther than a radius from all roots."""
    tree = cKDTree(roots)
    spacing = float(np.quantile(tree.query(roots, k=[min(2, len(roots))])[0], 0.9))
    radius = float(np.clip(RADIUS_OF_SPACING * spacing, SCALP_RADIUS, LARGEST_SCALP_RADIUS))
    distance, _ = tree.query(vertices, distance_upper_bound=radius)
    return np.clip(2.0 - 2.0 * distance / radius, 0.0, 1.0)


def _create_context() -> moderngl.Context:
    # Without development packages only the versioned library names exist.
    attempts: list[dict[str, Any]] = [
        {"backend": "egl", "libegl": "libEGL.so.1", "libgl": "libGL.so.1"},
        {"backend": "egl"},
        {},
    ]
    reason = ""
    for options in attempts:
        try:
            return moderngl.create_context(standalone=True, require=330, **options)
        except Exception as error:  # the binding raises bare Exception for a missing library or driver
            reason = reason or str(error).splitlines()[0]
    raise InputError(
        "OpenGL", "an off-screen context of version 3.3 (Debian: apt install libegl1 libgl1 libgl1-mesa-dri)", reason
    )


def _unit(vector: tuple[float, float, float]) -> np.ndarray:
    return np.array(vector) / np.linalg.norm(vector)
