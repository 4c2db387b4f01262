"""Jobs of the live page: changes of its state, drapes, measurements, files. All of them run on one thread."""

import re
import sys
import traceback
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from statistics import median

from quaffure.apps.viewer.catalogue import Catalogue
from quaffure.apps.viewer.draping_thread import DrapingThread
from quaffure.apps.viewer.hair_drawing import Display, HairDrawing
from quaffure.apps.viewer.panel import Panel
from quaffure.apps.viewer.picture import BrowserCamera, png_of
from quaffure.apps.viewer.scene_nodes import SceneNodes
from quaffure.apps.viewer.settings import Settings
from quaffure.apps.viewer.view_state import Drape, ViewState
from quaffure.draper import ClipDraper
from quaffure.drapers import LIVE_DRAPERS, NEURAL
from quaffure.errors import InputError
from quaffure.hair.drape_sequence import DrapeSequence
from quaffure.hair.guide_interpolation import GuideInterpolation
from quaffure.io.drape_file import write_drape

PictureWriter = Callable[[Path, DrapeSequence, GuideInterpolation | None], None]
Notify = Callable[[str, str, bool], None]
RECENT = 15  # drapes, of whose times the median is shown
MOST_DRAPES = 40  # of one state, in which hair that follows comes to rest


class Session:
    """One state of the page and its drape. `ask` and the methods that start with `ask_` return at once and leave the
    work to the thread; the other methods are that work.

    Args:
        state: to start with.
        drawing: of the strands that are drawn.
        panel: where metrics are written.
        nodes: where the drape is drawn.
        notify: shows a title and a text, as an error or not, in every browser.
        save: the folder for files, and the writer of a picture of a drape with the strands between its guides.

    Attributes:
        state: what is shown or about to be shown. If draping it fails, the last draped state comes back.
        shown: the drape on the page; None before the first.
        thread: runs all jobs; only it changes the state.
    """

    def __init__(
        self,
        state: ViewState,
        catalogue: Catalogue,
        drawing: HairDrawing,
        panel: Panel,
        nodes: SceneNodes,
        notify: Notify,
        save: tuple[Path, PictureWriter],
    ) -> None:
        self.state = state
        self.shown: Drape | None = None
        self._draped: tuple[ViewState, Settings] | None = None
        self._catalogue, self._drawing = catalogue, drawing
        self._panel, self._nodes, self._notify = panel, nodes, notify
        self._folder, self._write_picture = save
        self._drapes_left = MOST_DRAPES
        self._times: deque[tuple[float, float | None]] = deque(maxlen=RECENT)
        self.thread = DrapingThread(self.report)

    def ask(self, job: Callable[[], None]) -> None:
        """Run a method of the session on its thread."""
        self.thread.request(job.__name__, job)

    def ask_edit(self, kind: str, change: Callable[[ViewState], ViewState]) -> None:
        """Change the state and drape it; a newer change of the same kind replaces one that waits."""
        self.thread.request(kind, lambda: self._edit(change))
        self.ask(self.drape)

    def ask_display(self, display: Display) -> None:
        """Draw drapes in another way, also the one that is shown."""
        self.thread.request("display", lambda: self._set_display(display))

    def ask_settings(self, settings: Settings) -> None:
        """Show what settings describe, also in the widgets."""
        self.thread.request("settings", lambda: self._take(settings))
        self.ask(self.drape)

    def ask_picture(self, seen_by: BrowserCamera, send: Callable[[str, bytes], None]) -> None:
        """Draw the drape that is shown as a browser shows it.

        Args:
            send: called with the name of the file and its content.
        """
        self.thread.request("picture", lambda: self._draw_picture(seen_by, send))

    def _edit(self, change: Callable[[ViewState], ViewState]) -> None:
        before, self.state = self.state, change(self.state)
        self._drapes_left = MOST_DRAPES
        if self.state.motion is not before.motion and isinstance(self.state.draper, ClipDraper):
            self.state.draper.restart()

    def _take(self, settings: Settings) -> None:
        state = self._catalogue.state(settings)  # raises before anything on the page has changed
        self._edit(lambda _: state)
        self._drawing.display = Display(settings.strand_count, settings.mark_inside)
        self._nodes.set_translucent(settings.mark_inside)
        self._panel.show(settings, len(state.motion))

    def drape(self) -> None:
        """Drape the state after a change: by the network if the draper is too slow to follow every change, and again
        while the hair of one that follows is on its way."""
        slow = None if self.state.draper.name in LIVE_DRAPERS else self.state.draper.name
        with self._restored_on_failure():
            state = self.state if slow is None else replace(self.state, draper=self._catalogue.draper(NEURAL))
            if self.shown is None:
                state.drape()  # compiles kernels: its time would mislead
            self._show(state.drape())
        self._panel.offer_settling(slow)
        if isinstance(state.draper, ClipDraper) and state.draper.is_moving and self._drapes_left > 0:
            self._drapes_left -= 1
            self.ask(self.drape)

    def settle(self) -> None:
        """Drape the state by its draper, however long that takes."""
        name = self.state.draper.name
        with self._restored_on_failure():
            self._panel.status.content = f"Settling with **{name}**: seconds to minutes. Changes wait until it is done."
            self._show(self.state.drape())

    @contextmanager
    def _restored_on_failure(self) -> Iterator[None]:
        """If draping fails in the block, restore the last draped state, with its settings and status in the panel.

        Otherwise every later change would start from a state that cannot be draped, and fail too.
        """
        status, settings = self._panel.status.content, self._panel.settings()
        try:
            yield
        except Exception:
            self._panel.status.content = status
            if self._draped is not None:
                self.state, shown = self._draped
                self._panel.show(shown, len(self.state.motion))
            raise
        self._draped = self.state, settings

    def _show(self, drape: Drape) -> None:
        picture = self._drawing.strands(drape)  # may fail, and then nothing on the page has changed
        before, self.shown = self.shown, drape
        new_groom = before is None or before.state.groom is not drape.state.groom
        if new_groom:
            self._nodes.set_groom(drape.state.groom)
        if new_groom or (before is not None and before.state.draper.name != drape.state.draper.name):
            self._times.clear()
        self._times.append((drape.milliseconds, drape.network_milliseconds))
        self._nodes.show(drape.body_vertices, *picture, drape.path)
        self._panel.metrics.content = ""
        self._panel.status.content = self._status(drape)

    def _set_display(self, display: Display) -> None:
        before, self._drawing.display = self._drawing.display, display
        if self.shown is not None:
            try:
                picture = self._drawing.strands(self.shown)
            except Exception:
                self._drawing.display = before
                raise
            self._nodes.show(self.shown.body_vertices, *picture, self.shown.path)
            self._panel.status.content = self._status(self.shown)
        self._nodes.set_translucent(display.mark_inside)

    def _status(self, drape: Drape) -> str:
        totals, networks = zip(*self._times)
        hair = f"**{drape.state.draper.name}**, {len(drape.state.groom):,} guides, {self._drawing.note(drape)}"
        text = f"{hair}\n\n{median(totals):.1f} ms a drape"
        known = [milliseconds for milliseconds in networks if milliseconds is not None]
        return f"{text}, network {median(known):.1f} ms" if known else text

    def measure(self) -> None:
        """Write metrics of the drape that is shown to the panel."""
        if self.shown is not None:
            draped, posed = self.shown.metrics()
            rows = [f"| {name} | {value:.3g} | {posed[name]:.3g} |" for name, value in draped.items()]
            header = [f"| | {self.shown.state.draper.name} | posed |", "|---|---|---|"]
            self._panel.metrics.content = "\n".join(header + rows)

    def save(self) -> None:
        """Write the drape that is shown, and a picture of it."""
        if self.shown is not None:
            path = free_path(self._folder, self.shown)
            picture, interpolation = path.with_suffix(".png"), self._drawing.interpolation(self.shown)
            write_drape(path, self.shown.sequence)
            self._write_picture(picture, self.shown.sequence, interpolation)
            self._notify("Saved", f"{path} and {picture.name}", False)

    def _draw_picture(self, seen_by: BrowserCamera, send: Callable[[str, bytes], None]) -> None:
        if self.shown is not None:
            png = png_of(self.shown, self._drawing.interpolation(self.shown), seen_by)
            send(f"{file_stem(self.shown)}.png", png)

    def report(self, error: Exception) -> None:
        """Show in the browsers why a job failed. The page continues with the last draped state."""
        if not isinstance(error, InputError):
            traceback.print_exception(error, file=sys.stderr)
        title = "That did not work" if isinstance(error, InputError) else type(error).__name__
        self._notify(title, str(error), True)


def file_stem(drape: Drape) -> str:
    """Name of files of a drape, without a suffix."""
    state = drape.state
    words = f"{state.groom.name}_{state.motion.name}_{state.frame:04d}_{state.draper.name}"
    return re.sub(r"[^\w.-]+", "_", words)


def free_path(folder: Path, drape: Drape) -> Path:
    """A path for the drape's .npz that no file of the folder has, with a .png of the same name free as well.

    Raises:
        InputError: ten thousand drapes of that name.
    """
    stem = file_stem(drape)
    for suffix in ("", *(f"_{number}" for number in range(2, 10_000))):
        path = folder / f"{stem}{suffix}.npz"
        if not path.exists() and not path.with_name(f"{stem}{suffix}.png").exists():
            return path
    raise InputError(folder, "space for another drape", f"ten thousand with the name {stem}")
