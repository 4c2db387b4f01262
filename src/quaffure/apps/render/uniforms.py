"""Values for the variables of a shader program."""

import moderngl
import numpy as np


def assign(program: moderngl.Program, **uniforms: int | float | tuple[float, ...] | np.ndarray) -> None:
    """Set uniforms by name; matrices in rows, as numpy has them."""
    for name, value in uniforms.items():
        if name in program:  # the compiler drops what a shader does not use
            uniform = program[name]
            assert isinstance(uniform, moderngl.Uniform)
            if isinstance(value, np.ndarray):
                uniform.write(value.T.astype(np.float32).tobytes())  # OpenGL reads columns first
            else:
                uniform.value = value
