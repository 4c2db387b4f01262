"""Shadow of the key light: a depth map for the body, a deep opacity map for hair.

A strand is far thinner than a texel of any shadow map, and a depth map would make each one an opaque bar: streaks on
the skin wherever hair is thin. So the hair's shadow is a deep opacity map (Yuksel and Keyser 2008): the depth, from
the light, of the first hair in a texel, and the optical thickness of all hair up to some distances behind it.
"""

import moderngl
import numpy as np

from quaffure.apps.render.camera import look_at
from quaffure.apps.render.shaders import Uniforms, assign, build_program

BODY_MAP_SIZE, HAIR_MAP_SIZE = 1024, 512
HEAD_OF_HAIR = 8.0
"""Sum of the widths of all strands of a head [m]: a hundred thousand of 0.08 mm. The drawn strands, however many,
stand for these."""
FEWEST_ON_A_HEAD = 2000
"""Fewer strands than this do not count as a full head of hair."""
HAIR_EXTINCTION = 0.25
"""Share of the light on a hair that is absorbed; the rest is scattered towards its neighbours [-]."""


class KeyLight:
    """A distant light with its shadow maps, for programs that include `key_shadow.glsl`.

    Args:
        gl: the context to draw in.
    """

    BODY_UNIT, FIRST_UNIT, THICKNESS_UNIT = 1, 2, 3

    def __init__(self, gl: moderngl.Context) -> None:
        self._gl = gl
        self._body_depth = _depth_texture(gl, BODY_MAP_SIZE)
        self._first_hair = _depth_texture(gl, HAIR_MAP_SIZE)
        self._thickness = gl.texture((HAIR_MAP_SIZE, HAIR_MAP_SIZE), 4, dtype="f4")
        self._thickness.repeat_x = self._thickness.repeat_y = False
        self._thickness.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
        self._body_map = gl.framebuffer(depth_attachment=self._body_depth)
        self._first_map = gl.framebuffer(depth_attachment=self._first_hair)
        hidden = gl.depth_renderbuffer((HAIR_MAP_SIZE, HAIR_MAP_SIZE))
        self._thickness_map = gl.framebuffer([self._thickness], hidden)
        self._first_lines = gl.vertex_array(build_program(gl, "line", "depth"), [])
        self._thickness_lines = gl.vertex_array(build_program(gl, "line", "thickness"), [])

    def place(self, direction: np.ndarray, lowest: np.ndarray, highest: np.ndarray) -> None:
        """Put the light in `direction` (unit) from the box that shadows are computed in, `lowest` to `highest` [m]."""
        centre, radius = 0.5 * (lowest + highest), 0.5 * float(np.linalg.norm(highest - lowest))
        orthographic = np.diag([1.0 / radius, 1.0 / radius, -1.0 / radius, 1.0])
        orthographic[2, 3] = -4.0
        self.direction, self.radius = direction, radius
        self.eye = centre + 4.0 * radius * direction
        self.key_from_world = orthographic @ look_at(self.eye, centre)

    def draw_maps(self, body: moderngl.VertexArray, strands: int, vertices: int) -> None:
        """Draw the shadow maps. Texture unit 0 holds the points of the strands.

        Args:
            body: triangles with a program that takes `clip_from_world` and writes depth alone.
            strands, vertices: number of strands, and of vertices on each.
        """
        texel = 2.0 * self.radius / HAIR_MAP_SIZE
        uniforms: Uniforms = {
            "clip_from_world": self.key_from_world,
            "points": 0,
            "strand_vertices": vertices,
            "first_hair": self.FIRST_UNIT,
            "key_depth_range": 2.0 * self.radius,
            "thickness": HAIR_EXTINCTION * HEAD_OF_HAIR / max(strands, FEWEST_ON_A_HEAD) / texel,
        }
        for lines in (self._first_lines, self._thickness_lines):
            assign(lines.program, **uniforms)
        assign(body.program, eye=self.eye, clip_from_world=self.key_from_world)
        self._gl.enable(moderngl.DEPTH_TEST)
        self._body_map.use()
        self._body_map.clear()
        body.render(moderngl.TRIANGLES)
        self._first_map.use()
        self._first_map.clear()
        self._first_lines.render(moderngl.LINE_STRIP, vertices=vertices, instances=strands)
        self._draw_thickness(body, strands, vertices)

    def _draw_thickness(self, body: moderngl.VertexArray, strands: int, vertices: int) -> None:
        # Hair behind the body casts no shadow on its front: the body's depth hides it.
        target = self._thickness_map
        target.use()
        target.depth_mask, target.color_mask = True, (False,) * 4
        target.clear(depth=1.0)
        body.render(moderngl.TRIANGLES)
        target.depth_mask, target.color_mask = False, (True,) * 4
        target.clear(0.0, 0.0, 0.0, 0.0)
        self._first_hair.use(self.FIRST_UNIT)
        self._gl.enable(moderngl.BLEND)
        self._gl.blend_func = moderngl.ONE, moderngl.ONE
        self._thickness_lines.render(moderngl.LINE_STRIP, vertices=vertices, instances=strands)
        self._gl.disable(moderngl.BLEND)
        self._thickness.build_mipmaps()

    def use(self) -> Uniforms:
        """Bind the maps; returns the uniforms of the light."""
        self._body_depth.use(self.BODY_UNIT)
        self._first_hair.use(self.FIRST_UNIT)
        self._thickness.use(self.THICKNESS_UNIT)
        return {
            "body_depth": self.BODY_UNIT,
            "first_hair": self.FIRST_UNIT,
            "hair_thickness": self.THICKNESS_UNIT,
            "key_from_world": self.key_from_world,
            "key_depth_range": 2.0 * self.radius,
            "key_direction": self.direction,
        }


def _depth_texture(gl: moderngl.Context, size: int) -> moderngl.Texture:
    texture = gl.depth_texture((size, size))
    texture.compare_func = ""
    texture.repeat_x = texture.repeat_y = False
    texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
    return texture
