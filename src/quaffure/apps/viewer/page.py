"""The live page: a server for browsers, and its widgets connected to a session."""

import socket
import threading
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, TypeVar

from viser import GuiButtonGroupHandle, GuiEvent, GuiInputHandle, GuiSliderHandle

from quaffure.apps.viewer.catalogue import NEURAL, Catalogue
from quaffure.apps.viewer.guarded_server import guarded_server
from quaffure.apps.viewer.panel import STRAND_COUNTS, Panel, put
from quaffure.apps.viewer.playback import Playback
from quaffure.apps.viewer.scene_nodes import SceneNodes
from quaffure.apps.viewer.session import PictureWriter, Session
from quaffure.apps.viewer.view_state import MEAN_SHAPE, ViewState
from quaffure.energies.gravity import GRAVITY, NO_ACCELERATION
from quaffure.energies.loading import Loading
from quaffure.errors import InputError, refused

NOTICE_SECONDS = 8.0
RED, GREEN = (224, 49, 49), (47, 158, 68)
LAST_PORT = 65535

T = TypeVar("T")


def check_address(host: str, port: int) -> None:
    """Raises:
    InputError: nothing can listen there. viser itself would take another port, or never return.
    """
    if not 0 <= port <= LAST_PORT:
        raise InputError("port", f"0 to {LAST_PORT}", f"{port}")
    with refused(f"{host}:{port}", "a free address of this machine", OSError), socket.create_server((host, port)):
        pass


class Page:
    """Serves from construction until `stop`, its own origin alone. All browsers that open it share one state.

    Args:
        catalogue: choices of the pickers.
        start: names in the catalogue of the groom and the clip to start with.
        address: of this machine to listen at, and the port, 0 for any free one.
        folder: where drapes are saved.
        write_picture: writes a drape, with the strands between its guides, as a .png.

    Raises:
        InputError: the address is taken, or the catalogue does not have such names.
    """

    def __init__(
        self,
        catalogue: Catalogue,
        start: tuple[str, str],
        address: tuple[str, int],
        folder: Path,
        write_picture: PictureWriter,
    ) -> None:
        groom, motion = start
        state = ViewState(catalogue.body, catalogue.groom(groom), catalogue.motion(motion), catalogue.draper(NEURAL))
        check_address(*address)
        self._server = guarded_server(*address)
        self._catalogue = catalogue
        self._nodes = SceneNodes(self._server, catalogue.body)
        self.panel = Panel(self._server.gui, catalogue, groom, motion)
        self.session = Session(state, catalogue, self.panel, self._nodes, self._notify, (folder, write_picture))
        self._playback = Playback(self._show_due_frame)
        self._connect_inputs()
        self._connect_buttons()
        self.session.ask(self.session.drape)

    @property
    def url(self) -> str:
        return f"http://{self._server.get_host()}:{self._server.get_port()}"

    def wait(self) -> None:
        """Until the program is interrupted."""
        threading.Event().wait()

    def stop(self) -> None:
        """End playback, the draping thread and the server."""
        self._playback.stop()
        self.session.thread.stop()
        self._server.stop()

    def _notify(self, title: str, text: str, is_error: bool) -> None:
        for client in self._server.get_clients().values():
            client.add_notification(title, text, auto_close_seconds=NOTICE_SECONDS, color=RED if is_error else GREEN)

    def _on_user_change(self, widget: GuiInputHandle[T], handle: Callable[[T], None]) -> None:
        """Call `handle` with the widget's value when a user changes it in a browser, but not when the program does."""

        def on_update(event: GuiEvent[GuiInputHandle[T]]) -> None:
            if event.client_id is not None:
                if isinstance(widget, GuiSliderHandle):
                    put(widget, min(max(widget.value, widget.min), widget.max))
                self._run_and_report(lambda: handle(widget.value))

        widget.on_update(on_update)

    def _run_and_report(self, handle: Callable[[], None], _: object = None) -> None:
        try:
            handle()
        except Exception as error:
            self.session.report(error)

    def _connect_inputs(self) -> None:
        panel, on_change = self.panel, self._on_user_change
        on_change(panel.groom, partial(self._pick, "groom", self._catalogue.groom))
        on_change(panel.draper, partial(self._pick, "draper", self._catalogue.draper))
        on_change(panel.motion, self._pick_motion)
        on_change(panel.strands, lambda _: self._change_display())
        on_change(panel.mark_inside, lambda _: self._change_display())
        on_change(panel.frame, self._seek)
        on_change(panel.speed, lambda speed: setattr(self._playback, "speed", speed))
        for joint, sliders in panel.joints.items():
            for slider in sliders:
                on_change(slider, partial(self._rotate, joint))
        for index, slider in enumerate(panel.shape):
            on_change(slider, partial(self._shape, index))
        for slider in (panel.stiffness, *panel.gravity, *panel.wind):
            on_change(slider, self._load)

    def _connect_buttons(self) -> None:
        panel, session = self.panel, self.session
        for button, handle in (
            (panel.play, lambda: self._play(not self._playback.playing)),
            (panel.reset_pose, self._reset_pose),
            (panel.reset_shape, self._reset_shape),
            (panel.reset_loads, self._reset_loads),
            (panel.measure, lambda: session.ask(session.measure)),
            (panel.save, lambda: session.ask(session.save)),
            (panel.settle, self._settle),
        ):
            button.on_click(partial(self._run_and_report, handle))
        panel.view.on_click(lambda event: self._run_and_report(lambda: self._move_camera(event)))

    def _change_display(self) -> None:
        self.session.ask_display(STRAND_COUNTS[self.panel.strands.value], self.panel.mark_inside.value)

    def _pick(self, kind: str, load: Callable[[str], Any], name: str) -> None:
        self.session.ask_edit(kind, lambda state: replace(state, **{kind: load(name)}))

    def _pick_motion(self, name: str) -> None:
        def change(state: ViewState) -> ViewState:
            motion = self._catalogue.motion(name)
            self.panel.show_clip(len(motion))
            return state.playing(motion)

        self._playback.seek(0)
        self.session.ask_edit("motion", change)

    def _seek(self, frame: float) -> None:
        self._playback.seek(int(frame))
        self.session.ask_edit("frame", lambda state: state.at(int(frame)))

    def _play(self, plays: bool) -> None:
        self._playback.play() if plays else self._playback.pause()
        self.panel.play.label = "Pause" if plays else "Play"

    def _show_due_frame(self, frame: int) -> None:
        def change(state: ViewState) -> ViewState:
            moved = state.at(frame)
            put(self.panel.frame, moved.frame)
            return moved

        self.session.ask_edit("frame", change)

    def _rotate(self, joint: str, _: float) -> None:
        x, y, z = (float(slider.value) for slider in self.panel.joints[joint])
        self.session.ask_edit(f"rotation of {joint}", lambda state: state.rotated(joint, (x, y, z)))

    def _shape(self, index: int, coefficient: float) -> None:
        self.session.ask_edit(f"beta {index}", lambda state: state.shaped(index, float(coefficient)))

    def _reset_pose(self) -> None:
        for slider in chain.from_iterable(self.panel.joints.values()):
            put(slider, 0.0)
        self.session.ask_edit("reset of the pose", lambda state: replace(state, joint_rotations={}))

    def _reset_shape(self) -> None:
        for slider in self.panel.shape:
            put(slider, 0.0)
        self.session.ask_edit("reset of the shape", lambda state: replace(state, body_shape=MEAN_SHAPE))

    def _load(self, _: float) -> None:
        """Stiffness, gravity and wind from their sliders."""
        panel = self.panel
        x, y, z = (float(gravity.value + wind.value) for gravity, wind in zip(panel.gravity, panel.wind))
        loads = Loading(float(panel.stiffness.value), (x, y, z))
        self.session.ask_edit("loads", lambda state: replace(state, loads=loads))

    def _reset_loads(self) -> None:
        put(self.panel.stiffness, 1.0)
        for sliders, start in ((self.panel.gravity, GRAVITY), (self.panel.wind, NO_ACCELERATION)):
            for slider, value in zip(sliders, start):
                put(slider, value)
        self.session.ask_edit("reset of the hair", lambda state: replace(state, loads=Loading()))

    def _settle(self) -> None:
        self._play(False)
        self.session.ask(self.session.settle)

    def _move_camera(self, event: GuiEvent[GuiButtonGroupHandle]) -> None:
        if event.client is not None:
            self._nodes.move_camera(event.target.value, event.client)
