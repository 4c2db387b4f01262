"""The live page: a server for browsers, and its widgets wired to a session."""

import socket
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Literal, TypeVar

from viser import GuiButtonGroupHandle, GuiEvent, GuiInputHandle, ViserServer

from quaffure.apps.viewer.catalogue import NEURAL, Catalogue
from quaffure.apps.viewer.panel import STRAND_COUNTS, Panel, put
from quaffure.apps.viewer.playback import Playback
from quaffure.apps.viewer.scene_nodes import SceneNodes
from quaffure.apps.viewer.session import PictureWriter, Session
from quaffure.apps.viewer.stage import MEAN_SHAPE, Stage
from quaffure.errors import InputError

NOTICE_SECONDS = 8.0
LAST_PORT = 65535

T = TypeVar("T")


@dataclass(frozen=True)
class Address:
    """Where the page is served.

    Attributes:
        host: which of this machine's addresses to listen at.
        port: 0 for any free one.
    """

    host: str
    port: int

    def check(self) -> None:
        """Raises:
        InputError: nothing can listen there. viser itself would take another port, or never return.
        """
        if not 0 <= self.port <= LAST_PORT:
            raise InputError("port", f"0 to {LAST_PORT}", f"{self.port}")
        try:
            with socket.create_server((self.host, self.port)):
                pass
        except OSError as error:
            raise InputError(f"{self.host}:{self.port}", "a free address of this machine", str(error)) from error


class Page:
    """Serves from when it is made until `stop`. All browsers that open it share one stage.

    Args:
        catalogue: what the pickers offer.
        start: names in the catalogue of the groom and the clip to start with.
        folder: where drapes are saved.
        write_picture: writes a drape, with the strands between its guides, as a .png.

    Raises:
        InputError: the address is taken, or the catalogue does not have such names.
    """

    def __init__(
        self,
        catalogue: Catalogue,
        start: tuple[str, str],
        address: Address,
        folder: Path,
        write_picture: PictureWriter,
    ) -> None:
        groom, motion = start
        stage = Stage(catalogue.body, catalogue.groom(groom), catalogue.motion(motion), catalogue.draper(NEURAL))
        address.check()
        self._server = ViserServer(host=address.host, port=address.port, verbose=False)
        self._catalogue = catalogue
        self._nodes = SceneNodes(self._server, catalogue.body)
        self.panel = Panel(self._server.gui, catalogue, groom, motion)
        self.session = Session(stage, catalogue, self.panel, self._nodes, self._notify, (folder, write_picture))
        self._playback = Playback(self._show_due_frame)
        self._wire_pickers()
        self._wire_playback()
        self._wire_sliders()
        self._wire_buttons()
        self.session.ask_drape()

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
        colour: Literal["red", "green"] = "red" if is_error else "green"
        for client in self._server.get_clients().values():
            client.add_notification(title, text, auto_close_seconds=NOTICE_SECONDS, color=colour)

    def _by_hand(self, widget: GuiInputHandle[T], do: Callable[[T], None]) -> None:
        """Call `do` with the widget's value when someone changes it in a browser, and not when the program does."""

        def on_update(event: GuiEvent[GuiInputHandle[T]]) -> None:
            if event.client_id is not None:
                self._guarded(lambda: do(widget.value))

        widget.on_update(on_update)

    def _guarded(self, do: Callable[[], None]) -> None:
        try:
            do()
        except Exception as error:
            self.session.report(error)

    def _wire_pickers(self) -> None:
        panel, catalogue, edit = self.panel, self._catalogue, self.session.ask_edit
        self._by_hand(
            panel.groom, lambda name: edit("groom", lambda stage: replace(stage, groom=catalogue.groom(name)))
        )
        self._by_hand(
            panel.draper, lambda name: edit("draper", lambda stage: replace(stage, draper=catalogue.draper(name)))
        )
        self._by_hand(panel.motion, self._pick_motion)
        self._by_hand(panel.strands, lambda _: self._look())
        self._by_hand(panel.mark_inside, lambda _: self._look())

    def _look(self) -> None:
        self.session.ask_look(STRAND_COUNTS[self.panel.strands.value], self.panel.mark_inside.value)

    def _pick_motion(self, name: str) -> None:
        def change(stage: Stage) -> Stage:
            motion = self._catalogue.motion(name)
            self.panel.show_clip(len(motion))
            return stage.playing(motion)

        self._playback.seek(0)
        self.session.ask_edit("motion", change)

    def _wire_playback(self) -> None:
        self._by_hand(self.panel.frame, self._seek)
        self._by_hand(self.panel.speed, self._set_speed)
        self.panel.play.on_click(lambda _: self._guarded(lambda: self._play(not self._playback.playing)))

    def _seek(self, frame: float) -> None:
        self._playback.seek(int(frame))
        self.session.ask_edit("frame", lambda stage: stage.at(int(frame)))

    def _set_speed(self, speed: float) -> None:
        self._playback.speed = speed

    def _play(self, plays: bool) -> None:
        self._playback.play() if plays else self._playback.pause()
        self.panel.play.label = "Pause" if plays else "Play"

    def _show_due_frame(self, frame: int) -> None:
        def change(stage: Stage) -> Stage:
            moved = stage.at(frame)
            put(self.panel.frame, moved.frame)
            return moved

        self.session.ask_edit("frame", change)

    def _wire_sliders(self) -> None:
        for joint, sliders in self.panel.joints.items():
            for slider in sliders:
                self._by_hand(slider, partial(self._turn, joint))
        for index, slider in enumerate(self.panel.shape):
            self._by_hand(slider, partial(self._shape, index))
        self.panel.reset_pose.on_click(lambda _: self._guarded(self._reset_pose))
        self.panel.reset_shape.on_click(lambda _: self._guarded(self._reset_shape))

    def _turn(self, joint: str, _: float) -> None:
        x, y, z = (float(slider.value) for slider in self.panel.joints[joint])
        self.session.ask_edit(f"turn of {joint}", lambda stage: stage.turned(joint, (x, y, z)))

    def _shape(self, index: int, coefficient: float) -> None:
        self.session.ask_edit(f"beta {index}", lambda stage: stage.shaped(index, float(coefficient)))

    def _reset_pose(self) -> None:
        for slider in chain.from_iterable(self.panel.joints.values()):
            put(slider, 0.0)
        self.session.ask_edit("reset of the pose", lambda stage: replace(stage, joint_turns={}))

    def _reset_shape(self) -> None:
        for slider in self.panel.shape:
            put(slider, 0.0)
        self.session.ask_edit("reset of the shape", lambda stage: replace(stage, body_shape=MEAN_SHAPE))

    def _wire_buttons(self) -> None:
        panel, session = self.panel, self.session
        panel.measure.on_click(lambda _: session.ask_measure())
        panel.save.on_click(lambda _: session.ask_save())
        panel.settle.on_click(lambda _: self._guarded(self._settle))
        panel.view.on_click(lambda event: self._guarded(lambda: self._turn_camera(event)))

    def _settle(self) -> None:
        self._play(False)
        self.session.ask_settle()

    def _turn_camera(self, event: GuiEvent[GuiButtonGroupHandle]) -> None:
        if event.client is not None:
            self._nodes.look_from(event.target.value, event.client)
