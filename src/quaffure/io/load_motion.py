"""Motion by name: a bundled clip or a file."""

import os
from pathlib import Path

from quaffure.body.body_model import BodyModel, load_body
from quaffure.body.clips import CLIP_NAMES, bundled_clip
from quaffure.body.motion import Motion, resample
from quaffure.errors import InputError
from quaffure.input_file import did_you_mean, file_and_clip
from quaffure.io.read_motion import read_motion

FPS = 30.0


def load_motion(
    source: str | Path, body: BodyModel | None = None, in_place: bool = False, joints: Path | None = None
) -> Motion:
    """A bundled clip by name, or the motion in a file (.bvh, .glb, .gltf, .fbx, .npz), at 30 frames per second.

    Args:
        source: the name or the path; `FILE.glb#NAME` is one of several animations of a character.
        body: that it is for; the bundled one by default.
        in_place: without the path of the body through the world.
        joints: a joint map for a file with a skeleton of its own.

    Returns:
        The motion; its `notes` say what the reader of the file guessed, and `Motion.frames` is a part of it.

    Raises:
        InputError: neither; or what the file's reader refuses.
    """
    body, name = body or load_body(), str(source)
    if name in CLIP_NAMES:
        if joints is not None:
            raise InputError(joints, "a joint map for a motion file or a character", f"the bundled motion {name}")
        return bundled_clip(name, body)
    if os.path.isdir(name):  # not Path.is_dir, which raises where the text is longer than a name can be
        raise InputError(name, "a motion file", "a folder")
    if not file_and_clip(name)[0].suffix:
        raise InputError(
            f"motion '{name}'", f"a file or one of {', '.join(CLIP_NAMES)}", f"neither{did_you_mean(name, CLIP_NAMES)}"
        )
    motion = resample(read_motion(Path(name), body, joints), FPS)
    return motion.in_place() if in_place else motion
