"""Choices of the pickers of the live page, loaded when they are first picked and then kept."""

import torch

from quaffure.apps.viewer.settings import Settings
from quaffure.apps.viewer.view_state import ViewState
from quaffure.body.clips import CLIP_FPS, CLIP_NAMES, bundled_clip
from quaffure.body.motion import Motion
from quaffure.draper import Draper
from quaffure.drapers import LIVE_DRAPERS, NEURAL, make_draper, with_coherence
from quaffure.errors import InputError
from quaffure.hair.groom import Groom
from quaffure.hair.guide_interpolation import GuideInterpolation, interpolation_of
from quaffure.io.load_groom import load_groom
from quaffure.model.network_config import POSE_SIZE
from quaffure.model.quaffure_model import Quaffure
from quaffure.procedural.hair_style import STYLES
from quaffure.solvers.by_name import SOLVERS

REST = "rest"


class Catalogue:
    """Grooms, clips and drapers by name.

    Args:
        model: the network and the body.
        groom: a groom of the user, in addition to the bundled styles.
        motion: a motion of the user at 30 frames per second, in addition to the bundled clips.
    """

    def __init__(self, model: Quaffure, groom: Groom | None = None, motion: Motion | None = None) -> None:
        self.body = model.body
        self._model = model
        self._grooms = {} if groom is None else {_unique_name(groom.name, tuple(STYLES)): groom}
        self._motions = {REST: Motion(torch.zeros(1, POSE_SIZE), CLIP_FPS, REST)}
        if motion is not None:
            self._motions[_unique_name(motion.name, (*CLIP_NAMES, REST))] = motion
        self._interpolation: tuple[Groom, GuideInterpolation] | None = None
        self.groom_names = (*self._grooms, *STYLES)
        self.motion_names = tuple(dict.fromkeys((*reversed(self._motions), *CLIP_NAMES)))
        self.draper_names = (*LIVE_DRAPERS, *(name for name in SOLVERS if name not in LIVE_DRAPERS))

    def groom(self, name: str) -> Groom:
        """Raises:
        InputError: no groom of that name.
        """
        if name not in self.groom_names:
            raise InputError("groom", f"one of {', '.join(self.groom_names)}", f"'{name:.60}'")
        if name not in self._grooms:
            self._grooms[name] = load_groom(name, self.body)
        return self._grooms[name]

    def motion(self, name: str) -> Motion:
        """Raises:
        InputError: no clip of that name.
        """
        if name not in self._motions:
            self._motions[name] = bundled_clip(name, self.body)
        return self._motions[name]

    def draper(self, name: str) -> Draper:
        """With the material that the weights were trained for, so that drapes can be compared; one that follows from
        frame to frame where there is one.

        Raises:
            InputError: no draper of that name.
        """
        if name == NEURAL:
            return self._model.draper
        return with_coherence(make_draper(name, self._model.draper.material))

    def state(self, settings: Settings) -> ViewState:
        """What the widgets of the page describe.

        Raises:
            InputError: no groom, clip or draper of that name, or a frame outside of the clip.
        """
        return ViewState(
            self.body,
            self.groom(settings.groom),
            self.motion(settings.motion),
            self.draper(settings.draper),
            settings.frame,
            settings.rotated_joints,
            settings.body_shape,
            settings.loading,
        )

    def interpolation(self, groom: Groom, strands: int) -> GuideInterpolation:
        """Interpolation of strands between the guides of a groom; the last one is kept."""
        kept = self._interpolation
        if kept is None or kept[0] is not groom or len(kept[1]) != strands:
            kept = self._interpolation = groom, interpolation_of(groom, self.body, strands)
        return kept[1]


def _unique_name(name: str, taken: tuple[str, ...]) -> str:
    """A name that no bundled groom or clip has."""
    return f"{name} (file)" if name in taken else name
