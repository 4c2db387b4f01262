"""The widgets of the live page. They hold no logic: `Page` connects them."""

from typing import TypeVar

from viser import GuiApi, GuiSliderHandle

from quaffure.apps.render.camera import AZIMUTHS
from quaffure.apps.viewer.catalogue import Catalogue
from quaffure.energies.gravity import GRAVITY, NO_ACCELERATION, Acceleration

JOINT_RANGES = {
    "Head": 60.0,
    "Neck1": 45.0,
    "Neck": 45.0,
    "Spine1": 45.0,
    "LeftShoulder": 30.0,
    "RightShoulder": 30.0,
    "LeftArm": 90.0,
    "RightArm": 90.0,
}
"""Joints that move hair, and the range of their sliders, +- [degrees]."""
AXES = ("bend forward (x)", "lean left (y)", "turn left (z)")
LARGEST_COEFFICIENT = 3.0
LEAST_STIFFNESS, MOST_STIFFNESS = 0.3, 3.0
"""Fine and coarse hair, as multiples of the usual stiffness."""
WORLD_AXES = ("x (to the left)", "y (to the back)", "z (up)")
LARGEST_GRAVITY, LARGEST_WIND = 20.0, 10.0
"""Along an axis, +- [m/s^2]."""
STRAND_COUNTS = {"guides": 0, "5,000 strands": 5_000, "10,000 strands": 10_000, "20,000 strands": 20_000}

T = TypeVar("T", int, float)


class Panel:
    """Pickers, sliders and buttons, with the values that the page starts with."""

    def __init__(self, gui: GuiApi, catalogue: Catalogue, groom: str, motion: str) -> None:
        gui.configure_theme(show_logo=False, show_share_button=False, brand_color=(120, 84, 56))
        gui.set_panel_label("quaffure")
        gui.main_panel.dock_right()
        self.status = gui.add_markdown("Getting ready. The first drape on this machine compiles its kernels.")
        tabs = gui.add_tab_group()
        with tabs.add_tab("Drape"):
            self._add_pickers(gui, catalogue, groom, motion)
        with tabs.add_tab("Pose"):
            gui.add_markdown("Rotations after those of the clip, in degrees.")
            self.reset_pose = gui.add_button("Reset pose")
            self.joints = {joint: _joint_sliders(gui, joint, limit) for joint, limit in JOINT_RANGES.items()}
        with tabs.add_tab("Shape"):
            gui.add_markdown("In standard deviations of adults; the first is height.")
            self.reset_shape = gui.add_button("Reset shape")
            limit = LARGEST_COEFFICIENT
            self.shape = [gui.add_slider(f"beta {index}", -limit, limit, 0.1, 0.0) for index in range(10)]
        with tabs.add_tab("Hair"):
            self._add_loads(gui)
        with tabs.add_tab("Measure"):
            self.mark_inside = gui.add_checkbox("Mark hair inside the body", False)
            self.measure = gui.add_button("Measure this drape")
            self.metrics = gui.add_markdown("")
            self.save = gui.add_button("Save drape and picture", hint="An .npz and a .png")

    def _add_pickers(self, gui: GuiApi, catalogue: Catalogue, groom: str, motion: str) -> None:
        self.groom = gui.add_dropdown("Groom", catalogue.groom_names, initial_value=groom)
        self.strands = gui.add_dropdown("Show", tuple(STRAND_COUNTS))
        self.draper = gui.add_dropdown("Draper", catalogue.draper_names)
        self.notice = gui.add_markdown("", visible=False)
        self.settle = gui.add_button("Settle", visible=False, hint="Run the solver on this frame")
        gui.add_divider()
        self.motion = gui.add_dropdown("Clip", catalogue.motion_names, initial_value=motion)
        self.frame = gui.add_slider("Frame", 0, 1, 1, 0)
        self.show_clip(len(catalogue.motion(motion)))
        self.play = gui.add_button("Play")
        self.speed = gui.add_slider("Speed", 0.1, 2.0, 0.1, 1.0)
        gui.add_divider()
        self.view = gui.add_button_group("View", tuple(AZIMUTHS))

    def _add_loads(self, gui: GuiApi) -> None:
        gui.add_markdown("strand_newton reads these. Axes are the world's, as the body at rest has them.")
        self.reset_loads = gui.add_button("Reset hair")
        self.stiffness = gui.add_slider("stiffness", LEAST_STIFFNESS, MOST_STIFFNESS, 0.05, 1.0)
        self.gravity = _axis_sliders(gui, "Gravity [m/s^2]", LARGEST_GRAVITY, GRAVITY)
        self.wind = _axis_sliders(gui, "Wind [m/s^2]", LARGEST_WIND, NO_ACCELERATION)

    def show_clip(self, frames: int) -> None:
        """Set the frame slider to the length of a clip, at its start."""
        put(self.frame, 0)
        self.frame.max = max(1, frames - 1)

    def offer_settling(self, draper: str | None) -> None:
        """Show the button for a draper that is too slow to follow every change; hide it for None."""
        self.settle.visible = self.notice.visible = draper is not None
        if draper is not None:
            self.settle.label = f"Settle with {draper}"
            self.notice.content = f"Changes show the network's drape. {draper} takes seconds to minutes a frame."


def put(slider: GuiSliderHandle[T], value: T) -> None:
    """Move a slider in every browser."""
    # mypy reads the property as read-only: in viser another method is between its getter and its setter.
    slider.value = value  # type: ignore[misc]


def _axis_sliders(gui: GuiApi, name: str, limit: float, start: Acceleration) -> list[GuiSliderHandle[float]]:
    with gui.add_folder(name):
        return [gui.add_slider(axis, -limit, limit, 0.01, value) for axis, value in zip(WORLD_AXES, start)]


def _joint_sliders(gui: GuiApi, joint: str, limit: float) -> list[GuiSliderHandle[float]]:
    with gui.add_folder(joint, expand_by_default=joint == next(iter(JOINT_RANGES))):
        return [gui.add_slider(axis, -limit, limit, 1.0, 0.0) for axis in AXES]
