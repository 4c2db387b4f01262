"""The clock that plays a clip."""

import threading
import time
from collections.abc import Callable

from quaffure.body.clips import CLIP_FPS


class Playback:
    """Calls `on_frame` with the frame to show, `CLIP_FPS` times a second while it plays. Frames go on beyond the end.

    Args:
        on_frame: called with the index of the frame.

    Attributes:
        speed: 1 is real time.
    """

    def __init__(self, on_frame: Callable[[int], None]) -> None:
        self.speed = 1.0
        self._on_frame = on_frame
        self._position = 0.0
        self._moving = threading.Lock()
        self._playing = threading.Event()
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="quaffure-playback", daemon=True)
        self._thread.start()

    @property
    def playing(self) -> bool:
        return self._playing.is_set()

    def play(self) -> None:
        self._playing.set()

    def pause(self) -> None:
        self._playing.clear()

    def seek(self, frame: int) -> None:
        """Continue from this frame."""
        with self._moving:
            self._position = float(frame)

    def stop(self) -> None:
        """End the thread."""
        self._stopped.set()
        self._playing.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._stopped.is_set():
            self._playing.wait()
            before = time.perf_counter()
            if self._stopped.wait(1 / CLIP_FPS) or not self.playing:
                continue
            with self._moving:
                self._position += (time.perf_counter() - before) * CLIP_FPS * self.speed
                due = int(self._position)
            self._on_frame(due)
