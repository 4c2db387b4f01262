"""The scene of a body's character, from the file that its motion comes from."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from quaffure.body.body_model import BodyModel
from quaffure.body.character_clip import animation_of
from quaffure.body.clips import CLIP_NAMES
from quaffure.body.own_motion import is_own
from quaffure.hair.character_space import AnimatedSkin, CharacterSpace, skin_of
from quaffure.input_file import check_input_file, file_and_clip
from quaffure.io.read_character import CHARACTER_SUFFIXES, read_character
from quaffure.io.read_motion import MOTION_SUFFIXES


def read_character_space(body: BodyModel, source: str | Path, times: Float[np.ndarray, " f"]) -> CharacterSpace | None:
    """Where hair is in the file of a body's character; None of a body that has none.

    Args:
        source: name or file of the motion, or nothing. In a file of the character itself, its skin moves the roots,
            unless the file holds animations without meshes.
        times: of the frames in that file [s].

    Raises:
        InputError: no such file, or what `read_character` refuses.
    """
    if body.origin is None:
        return None
    start = float(times[0])
    path, clip = file_and_clip(source)
    if path.suffix.lower() not in CHARACTER_SUFFIXES:
        if str(source) not in ("", *CLIP_NAMES):
            check_input_file(path, f"a motion file ({', '.join(MOTION_SUFFIXES)}) or a bundled motion")
        return CharacterSpace(body.origin, start)
    if not is_own(body, character := read_character(path)):
        return CharacterSpace(body.origin, start)
    if not any(len(mesh.faces) for mesh in character.meshes):  # a file of animations alone
        return CharacterSpace(body.origin, start)
    scalp = body.rest_vertices[body.faces[body.scalp.faces].unique()].double().numpy()
    mesh = skin_of(character, body.origin, scalp)
    return CharacterSpace(body.origin, start, AnimatedSkin(character, animation_of(character, clip), mesh, times))
