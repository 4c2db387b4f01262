"""The widgets of the live page. They hold no logic: `Page` connects them."""

from itertools import chain
from typing import Any, TypeVar

from viser import GuiApi, GuiInputHandle, GuiSliderHandle

from quaffure.apps.render.camera import AZIMUTHS
from quaffure.apps.viewer.catalogue import Catalogue
from quaffure.apps.viewer.keys import keys_text
from quaffure.apps.viewer.settings import (
    JOINT_RANGES,
    LARGEST_COEFFICIENT,
    LARGEST_GRAVITY,
    LARGEST_WIND,
    LEAST_STIFFNESS,
    MOST_STIFFNESS,
    STRAND_COUNTS,
    Settings,
)
from quaffure.apps.viewer.view_state import NO_ROTATION, Degrees
from quaffure.body.body_model import SHAPE_COUNT
from quaffure.energies.gravity import Acceleration

AXES = ("bend forward (x)", "lean left (y)", "turn left (z)")
WORLD_AXES = ("x (to the left)", "y (to the back)", "z (up)")

T = TypeVar("T")


class Panel:
    """Pickers, sliders and buttons.

    Args:
        frames: of the clip.
        settings: values to start with.
    """

    def __init__(self, gui: GuiApi, catalogue: Catalogue, frames: int, settings: Settings) -> None:
        gui.configure_theme(show_logo=False, show_share_button=False, brand_color=(120, 84, 56))
        gui.set_panel_label("quaffure")
        gui.main_panel.dock_right()
        self.status = gui.add_markdown("Getting ready. The first drape on this machine compiles its kernels.")
        tabs = gui.add_tab_group()
        with tabs.add_tab("Drape"):
            self._add_pickers(gui, catalogue, settings)
            self._add_sharing(gui)
        with tabs.add_tab("Pose"):
            gui.add_markdown("Rotations after those of the clip, in degrees.")
            self.reset_pose = gui.add_button("Reset pose")
            self.joints = {joint: _joint_sliders(gui, joint, limit) for joint, limit in JOINT_RANGES.items()}
        with tabs.add_tab("Shape"):
            gui.add_markdown("In standard deviations of adults; the first is height.")
            self.reset_shape = gui.add_button("Reset shape")
            limit = LARGEST_COEFFICIENT
            self.shape = [gui.add_slider(f"beta {index}", -limit, limit, 0.1, 0.0) for index in range(SHAPE_COUNT)]
        with tabs.add_tab("Hair"):
            self._add_loads(gui, settings)
        with tabs.add_tab("Measure"):
            self.mark_inside = gui.add_checkbox("Mark hair inside the body", settings.mark_inside)
            self.measure = gui.add_button("Measure this drape")
            self.metrics = gui.add_markdown("")
        self.show(settings, frames)

    def _add_pickers(self, gui: GuiApi, catalogue: Catalogue, settings: Settings) -> None:
        self.groom = gui.add_dropdown("Groom", catalogue.groom_names, initial_value=settings.groom)
        self.strands = gui.add_dropdown("Show", tuple(STRAND_COUNTS), initial_value=settings.strands)
        self.draper = gui.add_dropdown("Draper", catalogue.draper_names, initial_value=settings.draper)
        self.notice = gui.add_markdown("", visible=False)
        self.settle = gui.add_button("Settle", visible=False, hint="Run the solver on this frame")
        gui.add_divider()
        self.motion = gui.add_dropdown("Clip", catalogue.motion_names, initial_value=settings.motion)
        self.frame = gui.add_slider("Frame", 0, 1, 1, 0)
        self.play = gui.add_button("Play")
        self.speed = gui.add_slider("Speed", 0.1, 2.0, 0.1, 1.0)
        gui.add_divider()
        self.view = gui.add_button_group("View", tuple(AZIMUTHS))

    def _add_sharing(self, gui: GuiApi) -> None:
        self.picture = gui.add_button(
            "Save picture", hint="What the camera shows, as a .png that the browser downloads"
        )
        self.make_link = gui.add_button("Link to this view", hint="An address that shows this again")
        self.link = gui.add_markdown("", visible=False)
        self.save = gui.add_button("Save drape", hint="An .npz and a .png in the folder of the program")
        with gui.add_folder("Keys", expand_by_default=False):
            gui.add_markdown(keys_text())

    def _add_loads(self, gui: GuiApi, settings: Settings) -> None:
        gui.add_markdown("`neural` and `strand_newton` read these. Axes are the world's, as the body at rest has them.")
        self.reset_loads = gui.add_button("Reset hair")
        self.stiffness = gui.add_slider("stiffness", LEAST_STIFFNESS, MOST_STIFFNESS, 0.05, settings.stiffness)
        self.gravity = _axis_sliders(gui, "Gravity [m/s^2]", LARGEST_GRAVITY, settings.gravity)
        self.wind = _axis_sliders(gui, "Wind [m/s^2]", LARGEST_WIND, settings.wind)

    def settings(self) -> Settings:
        """Values of all widgets."""
        return Settings(
            groom=self.groom.value,
            motion=self.motion.value,
            frame=int(value_of(self.frame)),
            draper=self.draper.value,
            strands=self.strands.value,
            mark_inside=self.mark_inside.value,
            joint_rotations={joint: self.rotation(joint) for joint in self.joints},
            body_shape=tuple(map(value_of, self.shape)),
            stiffness=value_of(self.stiffness),
            gravity=_triple(self.gravity),
            wind=_triple(self.wind),
        )

    def show(self, settings: Settings, frames: int) -> None:
        """Set all widgets, and the frame slider to the length of a clip."""
        for picker, choice in (
            (self.groom, settings.groom),
            (self.motion, settings.motion),
            (self.draper, settings.draper),
            (self.strands, settings.strands),
            (self.mark_inside, settings.mark_inside),
        ):
            _put_changed(picker, choice)
        self.show_clip(frames, settings.frame)
        rotations = (settings.joint_rotations.get(joint, NO_ROTATION) for joint in self.joints)
        sliders = (*chain.from_iterable(self.joints.values()), *self.shape, self.stiffness, *self.gravity, *self.wind)
        values = (*chain.from_iterable(rotations), *settings.body_shape, settings.stiffness)
        for slider, value in zip(sliders, (*values, *settings.gravity, *settings.wind)):
            _put_changed(slider, value)

    def rotation(self, joint: str) -> Degrees:
        """Values of the three sliders of a joint [degrees]."""
        return _triple(self.joints[joint])

    def show_clip(self, frames: int, frame: int = 0) -> None:
        """Set the frame slider to the length of a clip, and to a frame."""
        if frame > self.frame.max:  # a slider does not take a value beyond its end, nor an end before its value
            self.frame.max = frame
        put(self.frame, frame)
        self.frame.max = max(1, frames - 1)

    def show_link(self, address: str) -> None:
        """Show a link to copy.

        Args:
            address: relative to the page.
        """
        self.link.content = f"[Link to this view]({address}): copy its address, or open it in another tab."
        self.link.visible = True

    def offer_settling(self, draper: str | None) -> None:
        """Show the button for a draper that is too slow to follow every change; hide it for None."""
        self.settle.visible = self.notice.visible = draper is not None
        if draper is not None:
            self.settle.label = f"Settle with {draper}"
            self.notice.content = f"Changes show the network's drape. {draper} takes seconds to minutes a frame."


def put(widget: GuiInputHandle[T], value: T) -> None:
    """Set a slider or a picker in every browser."""
    # mypy reads the property as read-only: in viser another method is between its getter and its setter.
    widget.value = value  # type: ignore[misc]


def value_of(slider: GuiSliderHandle[Any]) -> float:
    """Value of a slider. A browser can send one beyond its ends."""
    return float(min(max(slider.value, slider.min), slider.max))


def _put_changed(widget: GuiInputHandle[Any], value: object) -> None:
    """Set a widget in every browser unless it has this value."""
    if widget.value != value:
        put(widget, value)


def _triple(sliders: list[GuiSliderHandle[float]]) -> tuple[float, float, float]:
    x, y, z = map(value_of, sliders)
    return x, y, z


def _axis_sliders(gui: GuiApi, name: str, limit: float, start: Acceleration) -> list[GuiSliderHandle[float]]:
    with gui.add_folder(name):
        return [gui.add_slider(axis, -limit, limit, 0.01, value) for axis, value in zip(WORLD_AXES, start)]


def _joint_sliders(gui: GuiApi, joint: str, limit: float) -> list[GuiSliderHandle[float]]:
    with gui.add_folder(joint, expand_by_default=joint == next(iter(JOINT_RANGES))):
        return [gui.add_slider(axis, -limit, limit, 1.0, 0.0) for axis in AXES]
