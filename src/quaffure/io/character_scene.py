"""The scene of a body's character, from the file that its motion comes from."""

from pathlib import Path

import numpy as np

from quaffure.body.body_model import BodyModel
from quaffure.body.character_clip import animation_of
from quaffure.body.motion import Motion
from quaffure.body.own_motion import is_own
from quaffure.hair.character_space import AnimatedSkin, CharacterSpace, skin_of
from quaffure.input_file import file_and_clip
from quaffure.io.gltf import read_character
from quaffure.io.gltf_document import GLTF_SUFFIXES


def read_character_space(body: BodyModel, motion: Motion, source: str | Path) -> CharacterSpace | None:
    """Where hair of a motion is in the file of a body's character; None of a body that has none.

    Args:
        motion: as it is draped.
        source: name or file that it comes from. In a file of the character itself, its skin moves the roots.

    Raises:
        InputError: what `read_character` refuses.
    """
    if body.origin is None:
        return None
    path, clip = file_and_clip(source)
    if path.suffix.lower() not in GLTF_SUFFIXES or not is_own(body, character := read_character(path)):
        return CharacterSpace(body.origin, motion.start)
    scalp = body.rest_vertices[body.faces[body.scalp.faces].unique()].double().numpy()
    times = motion.start + np.arange(len(motion)) / motion.fps
    skin = AnimatedSkin(character, animation_of(character, clip), skin_of(character, body.origin, scalp), times)
    return CharacterSpace(body.origin, motion.start, skin)
