"""What happens on the live page: changes to its stage, drapes, measurements, files. All of it on one thread."""

import re
import sys
import traceback
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from quaffure.apps.viewer.catalogue import LIVE, NEURAL, Catalogue
from quaffure.apps.viewer.draping_thread import DrapingThread
from quaffure.apps.viewer.hair_colours import hair_colours
from quaffure.apps.viewer.panel import Panel
from quaffure.apps.viewer.scene_nodes import SceneNodes
from quaffure.apps.viewer.stage import Drape, Stage
from quaffure.errors import InputError
from quaffure.hair.drape_sequence import DrapeSequence
from quaffure.hair.guide_interpolation import GuideInterpolation
from quaffure.io.drape_file import write_drape

PictureWriter = Callable[[Path, DrapeSequence, GuideInterpolation | None], None]
Notify = Callable[[str, str, bool], None]
RECENT = 15  # drapes, of whose times the median is shown


class Look(NamedTuple):
    """How a drape is drawn: with so many strands, or with 0 its guides; what is inside the body marked or not."""

    strand_count: int
    mark_inside: bool


class Session:
    """One stage and its drape. Every method that starts with `ask_` returns at once and leaves the work to its thread.

    Args:
        stage: to start with.
        panel: where figures are written.
        nodes: where the drape is drawn.
        notify: shows a title and a text, as an error or not, in every browser.
        save: the folder for files, and the writer of a picture of a drape with the strands between its guides.

    Attributes:
        stage: what is shown, or about to be. Where that fails, what is shown comes back.
        shown: the drape on the page; None before the first.
        thread: does all the work, and alone may change the stage.
    """

    def __init__(
        self,
        stage: Stage,
        catalogue: Catalogue,
        panel: Panel,
        nodes: SceneNodes,
        notify: Notify,
        save: tuple[Path, PictureWriter],
    ) -> None:
        self.stage = stage
        self.shown: Drape | None = None
        self._draped: Stage | None = None  # the last one that could be
        self._catalogue, self._panel, self._nodes, self._notify = catalogue, panel, nodes, notify
        self._folder, self._write_picture = save
        self._look = Look(0, False)
        self._times: deque[tuple[float, float | None]] = deque(maxlen=RECENT)
        self.thread = DrapingThread(self.report)

    def ask_edit(self, kind: str, change: Callable[[Stage], Stage]) -> None:
        """Change the stage and drape it; a newer change of the same kind replaces one that waits."""
        self.thread.request(kind, lambda: self._edit(change))
        self.thread.request("drape", self._drape)

    def ask_drape(self) -> None:
        self.thread.request("drape", self._drape)

    def ask_settle(self) -> None:
        """Run the stage's draper however long it takes."""
        self.thread.request("settle", self._settle)

    def ask_measure(self) -> None:
        """Write figures of merit of the drape that is shown to the panel."""
        self.thread.request("measure", self._measure)

    def ask_save(self) -> None:
        """Write the drape that is shown, and a picture of it."""
        self.thread.request("save", self._save)

    def ask_look(self, strand_count: int, mark_inside: bool) -> None:
        """Draw so many strands, or with 0 the guides; mark what is inside the body."""
        self.thread.request("look", lambda: self._change_look(Look(strand_count, mark_inside)))

    def _edit(self, change: Callable[[Stage], Stage]) -> None:
        self.stage = change(self.stage)

    def _drape(self) -> None:
        """What follows every change: solvers are too slow for that, so the network stands in."""
        slow = None if self.stage.draper.name in LIVE else self.stage.draper.name
        with self._undone_on_failure():
            stage = self.stage if slow is None else replace(self.stage, draper=self._catalogue.draper(NEURAL))
            if self.shown is None:
                stage.drape()  # compiles kernels: not a time to show
            self._show(stage.drape())
        self._panel.offer_settling(slow)

    def _settle(self) -> None:
        name = self.stage.draper.name
        with self._undone_on_failure():
            self._panel.status.content = f"Settling with **{name}**: seconds to minutes. Changes wait until it is done."
            self._show(self.stage.drape())

    @contextmanager
    def _undone_on_failure(self) -> Iterator[None]:
        """For what drapes the stage: if that fails, the last stage that was draped comes back, and the status with it.

        Otherwise every later change would be one of a stage that cannot be draped, and fail too.
        """
        status = self._panel.status.content
        try:
            yield
        except Exception:
            self.stage, self._panel.status.content = self._draped or self.stage, status
            raise
        self._draped = self.stage

    def _show(self, drape: Drape) -> None:
        picture = self._picture(drape, self._look)  # may fail, and then nothing on the page has changed
        before, self.shown = self.shown, drape
        if before is None or before.stage.groom is not drape.stage.groom:
            self._nodes.dress(drape.stage.groom)
            self._times.clear()
        elif before.stage.draper.name != drape.stage.draper.name:
            self._times.clear()
        self._times.append((drape.milliseconds, drape.network_milliseconds))
        self._nodes.show(drape.body_vertices, *picture)
        self._panel.figures.content = ""
        self._panel.status.content = self._status(drape)

    def _picture(self, drape: Drape, look: Look) -> tuple[Float[np.ndarray, "m n 3"], UInt8[np.ndarray, "m n 3"]]:
        """Strands to draw, and their colours."""
        between = self._between(drape, look)
        strands = drape.strands if between is None else between.strands(drape.strands, drape.body_vertices)
        return strands, hair_colours(strands, drape.inside(strands) if look.mark_inside else None)

    def _between(self, drape: Drape, look: Look) -> GuideInterpolation | None:
        count = look.strand_count
        return self._catalogue.interpolation(drape.stage.groom, count) if count else None

    def _change_look(self, look: Look) -> None:
        picture = None if self.shown is None else self._picture(self.shown, look)
        self._look = look
        self._nodes.show_through(look.mark_inside)
        if self.shown is not None and picture is not None:
            self._nodes.show(self.shown.body_vertices, *picture)

    def _status(self, drape: Drape) -> str:
        totals, networks = zip(*self._times)
        spent = f"{median(totals):.1f} ms a drape"
        known = [time for time in networks if time is not None]
        if known:
            spent += f", network {median(known):.1f} ms"
        return f"**{drape.stage.draper.name}**, {len(drape.stage.groom):,} guides\n\n{spent}"

    def _measure(self) -> None:
        if self.shown is None:
            return
        draped, posed = self.shown.figures()
        rows = [f"| {name} | {figure:.3g} | {posed[name]:.3g} |" for name, figure in draped.items()]
        header = [f"| | {self.shown.stage.draper.name} | posed |", "|---|---|---|"]
        self._panel.figures.content = "\n".join(header + rows)

    def _save(self) -> None:
        if self.shown is None:
            return
        path = free_path(self._folder, self.shown)
        write_drape(path, self.shown.sequence)
        self._write_picture(path.with_suffix(".png"), self.shown.sequence, self._between(self.shown, self._look))
        self._notify("Saved", f"{path} and {path.with_suffix('.png').name}", False)

    def report(self, error: Exception) -> None:
        """What a job could not do, told in the browser. The page goes on with the last stage that was good."""
        if not isinstance(error, InputError):
            traceback.print_exception(error, file=sys.stderr)
        title = "That did not work" if isinstance(error, InputError) else type(error).__name__
        self._notify(title, str(error), True)


def free_path(folder: Path, drape: Drape) -> Path:
    """A name for the drape's .npz that nothing in the folder has."""
    stage = drape.stage
    words = f"{stage.groom.name}_{stage.motion.name}_{stage.frame:04d}_{stage.draper.name}"
    stem = re.sub(r"[^\w.-]+", "_", words)
    names = (f"{stem}{suffix}" for suffix in ("", *(f"_{number}" for number in range(2, 10_000))))
    for name in names:
        if not any((folder / f"{name}{suffix}").exists() for suffix in (".npz", ".png")):
            return folder / f"{name}.npz"
    raise InputError(folder, "room for another drape", f"ten thousand called {stem}")
