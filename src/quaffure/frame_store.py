"""Where the frames of a drape are kept while it is made."""

from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float32


class Frames(NamedTuple):
    """Consecutive frames.

    Attributes:
        strands: draped vertices [m].
        posed: posed vertices [m].
        body_vertices: [m].
    """

    strands: Float32[np.ndarray, "f s n 3"]
    posed: Float32[np.ndarray, "f s n 3"]
    body_vertices: Float32[np.ndarray, "f v 3"]


@dataclass(frozen=True)
class BatchState:
    """What is known of a batch but its frames.

    Attributes:
        milliseconds: wall time of one of its drapes.
        draper_state: what the next frame follows from (`ResumableDraper.state`); None where frames are alone.
    """

    milliseconds: float
    draper_state: Float32[np.ndarray, "s k"] | None = None


@runtime_checkable
class FrameStore(Protocol):
    """Keeps frames in the order in which they come."""

    def __len__(self) -> int:
        """Number of frames, of whole batches."""
        ...

    @property
    def milliseconds(self) -> list[float]:
        """Wall time of a drape in every batch."""
        ...

    @property
    def draper_state(self) -> Float32[np.ndarray, "s k"] | None:
        """`BatchState.draper_state` of the last batch."""
        ...

    def append(self, frames: Frames, state: BatchState) -> None:
        """Keep the next batch."""
        ...

    def frames(self) -> Frames:
        """All frames; arrays may be files, which are read as they are used."""
        ...


class FramesInMemory:
    """Keeps all frames in memory."""

    def __init__(self) -> None:
        self._batches: list[Frames] = []
        self._states: list[BatchState] = []

    def __len__(self) -> int:
        return sum(len(batch.strands) for batch in self._batches)

    @property
    def milliseconds(self) -> list[float]:
        return [state.milliseconds for state in self._states]

    @property
    def draper_state(self) -> Float32[np.ndarray, "s k"] | None:
        return self._states[-1].draper_state if self._states else None

    def append(self, frames: Frames, state: BatchState) -> None:
        self._batches.append(frames)
        self._states.append(state)

    def frames(self) -> Frames:
        return Frames(*map(np.concatenate, zip(*self._batches)))
