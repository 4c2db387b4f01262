"""Shader programs from the GLSL files of `assets/shaders`."""

import re
from importlib.resources import files

import moderngl
import numpy as np

Value = int | float | tuple[float, ...] | np.ndarray
Uniforms = dict[str, Value]


def build_program(gl: moderngl.Context, vertex: str, fragment: str) -> moderngl.Program:
    """Compile `<vertex>_vertex.glsl` with `<fragment>_fragment.glsl`."""
    return gl.program(_source(f"{vertex}_vertex.glsl"), fragment_shader=_source(f"{fragment}_fragment.glsl"))


def assign(program: moderngl.Program, **uniforms: Value) -> None:
    """Set uniforms by name; matrices in rows, as numpy stores them."""
    for name, value in uniforms.items():
        if name in program:  # the compiler drops what a shader does not use
            uniform = program[name]
            assert isinstance(uniform, moderngl.Uniform)
            if isinstance(value, np.ndarray):
                uniform.write(value.T.astype(np.float32).tobytes())  # OpenGL stores columns first
            else:
                uniform.value = value


def _source(name: str) -> str:
    """The text of a file, with its `#include` lines replaced by the files that they name: GLSL itself has none."""
    text = files("quaffure").joinpath("assets", "shaders", name).read_text(encoding="utf-8")
    return re.sub(r'^#include "(.+)"$', lambda included: _source(included[1]), text, flags=re.MULTILINE)
