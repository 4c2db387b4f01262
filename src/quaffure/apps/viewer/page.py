"""The live page: a server for browsers, and its widgets connected to a session."""

import socket
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from viser import (
    ClientHandle,
    GuiButtonGroupHandle,
    GuiButtonHandle,
    GuiDropdownHandle,
    GuiEvent,
    GuiInputHandle,
    GuiSliderHandle,
)

from quaffure.apps.render.camera import AZIMUTHS
from quaffure.apps.viewer import keys
from quaffure.apps.viewer.catalogue import Catalogue
from quaffure.apps.viewer.guarded_server import guarded_server
from quaffure.apps.viewer.hair_drawing import Display, HairDrawing
from quaffure.apps.viewer.link import View, link_of, settings_of, split_query
from quaffure.apps.viewer.panel import Panel, put, value_of
from quaffure.apps.viewer.picture import BrowserCamera
from quaffure.apps.viewer.playback import Playback
from quaffure.apps.viewer.scene_nodes import SceneNodes
from quaffure.apps.viewer.session import PictureWriter, Session
from quaffure.apps.viewer.settings import AUTOMATIC, GUIDES, Settings
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
        start: what is shown first.
        address: of this machine to listen at, and the port, 0 for any free one.
        folder: where drapes are saved.
        write_picture: writes a drape, with the strands between its guides, as a .png.

    Raises:
        InputError: the address is taken, or the catalogue does not have such names.
    """

    def __init__(
        self,
        catalogue: Catalogue,
        start: Settings,
        address: tuple[str, int],
        folder: Path,
        write_picture: PictureWriter,
    ) -> None:
        state = catalogue.state(start)
        check_address(*address)
        self._server = guarded_server(*address, self._take_link)
        self._catalogue = catalogue
        self._notice = 0.0, ("", "", False)
        self._nodes = SceneNodes(self._server, catalogue.body)
        self.panel = Panel(self._server.gui, catalogue, len(state.motion), start)
        drawing = HairDrawing(catalogue, Display(start.strand_count, start.mark_inside))
        self.session = Session(
            state, catalogue, drawing, self.panel, self._nodes, self._notify, (folder, write_picture)
        )
        self._playback = Playback(self._show_due_frame)
        self._connect_inputs()
        self._connect_buttons()
        keys.add_keys(self._server.gui, self._key_actions())
        self._server.on_client_connect(self._welcome)
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
        self._notice = time.monotonic() + NOTICE_SECONDS, (title, text, is_error)
        for client in self._server.get_clients().values():
            _show_notice(client, *self._notice[1])

    def _welcome(self, client: ClientHandle) -> None:
        """Fit the camera of a browser that opened the page to its window, and show what it is too late for: the
        link that it opened may have failed."""
        client.camera.on_update(lambda _: self._nodes.fit_camera(client))
        end, notice = self._notice
        if time.monotonic() < end:
            _show_notice(client, *notice)

    def _on_user_change(self, widget: GuiInputHandle[T], handle: Callable[[T], None]) -> None:
        """Call `handle` with the widget's value when a user changes it in a browser, but not when the program does."""

        def on_update(event: GuiEvent[GuiInputHandle[T]]) -> None:
            if event.client_id is not None:
                if isinstance(widget, GuiSliderHandle):
                    put(widget, value_of(widget))
                self._run_and_report(lambda: handle(widget.value))

        widget.on_update(on_update)

    def _run_and_report(self, handle: Callable[[], None], _: object = None) -> None:
        try:
            handle()
        except Exception as error:
            self.session.report(error)

    def _connect_inputs(self) -> None:
        panel, on_change = self.panel, self._on_user_change
        on_change(panel.groom, self._pick_groom)
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
            (panel.play, self._toggle_playing),
            (panel.reset_pose, self._reset_pose),
            (panel.reset_shape, self._reset_shape),
            (panel.reset_loads, self._reset_loads),
            (panel.measure, lambda: session.ask(session.measure)),
            (panel.save, lambda: session.ask(session.save)),
            (panel.settle, self._settle),
        ):
            button.on_click(partial(self._run_and_report, handle))
        for button, action in ((panel.picture, self._send_picture), (panel.make_link, self._make_link)):
            button.on_click(partial(self._run_for_browser, action))
        panel.view.on_click(self._turn_camera)

    def _key_actions(self) -> dict[str, keys.Action]:
        """What each key does in a browser."""
        panel = self.panel

        def of_all(handle: Callable[[], None]) -> keys.Action:
            return lambda _: self._run_and_report(handle)

        return {
            keys.PLAY: of_all(self._toggle_playing),
            keys.NEXT_FRAME: of_all(lambda: self._step(1)),
            keys.PREVIOUS_FRAME: of_all(lambda: self._step(-1)),
            keys.FIRST_FRAME: of_all(lambda: self._go_to(0)),
            keys.NEXT_GROOM: of_all(lambda: self._pick_next(panel.groom, self._pick_groom)),
            keys.NEXT_CLIP: of_all(lambda: self._pick_next(panel.motion, self._pick_motion)),
            keys.SHOW_GUIDES: of_all(self._toggle_guides),
            keys.SAVE_PICTURE: lambda client: self._run_and_report(lambda: self._send_picture(client)),
            keys.MAKE_LINK: lambda client: self._run_and_report(lambda: self._make_link(client)),
            **{name: partial(self._nodes.move_camera, AZIMUTHS[view]) for name, view in keys.VIEWS.items()},
        }

    def _run_for_browser(self, action: keys.Action, event: GuiEvent[GuiButtonHandle]) -> None:
        client = event.client
        if client is not None:
            self._run_and_report(lambda: action(client))

    def _change_display(self) -> None:
        settings = self.panel.settings()
        self.session.ask_display(Display(settings.strand_count, settings.mark_inside))

    def _toggle_guides(self) -> None:
        picker = self.panel.strands
        put(picker, AUTOMATIC if picker.value == GUIDES else GUIDES)
        self._change_display()

    def _pick(self, kind: str, load: Callable[[str], Any], name: str) -> None:
        self.session.ask_edit(kind, lambda state: replace(state, **{kind: load(name)}))

    def _pick_groom(self, name: str) -> None:
        self._pick("groom", self._catalogue.groom, name)

    def _pick_next(self, picker: GuiDropdownHandle[str], pick: Callable[[str], None]) -> None:
        choices = picker.options
        put(picker, choices[(choices.index(picker.value) + 1) % len(choices)])
        pick(picker.value)

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

    def _go_to(self, frame: int) -> None:
        """Show a frame, and stop there; clips repeat."""
        self._play(False)
        put(self.panel.frame, frame % (int(self.panel.frame.max) + 1))
        self._seek(self.panel.frame.value)

    def _step(self, frames: int) -> None:
        self._go_to(int(self.panel.frame.value) + frames)

    def _toggle_playing(self) -> None:
        self._play(not self._playback.playing)

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
        degrees = self.panel.rotation(joint)
        self.session.ask_edit(f"rotation of {joint}", lambda state: state.rotated(joint, degrees))

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
        loading = self.panel.settings().loading
        self.session.ask_edit("loading", lambda state: replace(state, loading=loading))

    def _reset_loads(self) -> None:
        put(self.panel.stiffness, 1.0)
        for sliders, start in ((self.panel.gravity, GRAVITY), (self.panel.wind, NO_ACCELERATION)):
            for slider, value in zip(sliders, start):
                put(slider, value)
        self.session.ask_edit("reset of the hair", lambda state: replace(state, loading=Loading()))

    def _settle(self) -> None:
        self._play(False)
        self.session.ask(self.session.settle)

    def _turn_camera(self, event: GuiEvent[GuiButtonGroupHandle]) -> None:
        if event.client is not None:
            self._nodes.move_camera(AZIMUTHS[event.target.value], event.client)

    def _take_link(self, query: str) -> str | None:
        """Show what a link describes; returns its query without that."""
        try:
            fields, rest = split_query(query)
            if not fields:
                return None
            before = self.panel.settings()
            settings = settings_of(fields, before.groom, before.motion)
        except InputError as error:
            self.session.report(error)
            return ""
        self._play(False)
        self._playback.seek(settings.frame)
        self.session.ask_settings(settings)
        return rest

    def _make_link(self, client: ClientHandle) -> None:
        camera = client.camera
        self.panel.show_link(link_of(self.panel.settings(), View(_triple(camera.position), _triple(camera.look_at))))

    def _send_picture(self, client: ClientHandle) -> None:
        camera = client.camera
        seen_by = BrowserCamera(
            _triple(camera.position), _triple(camera.look_at), camera.fov, camera.image_width, camera.image_height
        )
        self.session.ask_picture(seen_by, partial(client.send_file_download, save_immediately=True))


def _show_notice(client: ClientHandle, title: str, text: str, is_error: bool) -> None:
    client.add_notification(title, text, auto_close_seconds=NOTICE_SECONDS, color=RED if is_error else GREEN)


def _triple(vector: np.ndarray) -> tuple[float, float, float]:
    x, y, z = map(float, vector)
    return x, y, z
