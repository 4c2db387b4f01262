"""The interface of every draping method."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from quaffure.config import HairMaterial
from quaffure.energies.loading import Loading
from quaffure.scene import Scene
from quaffure.types import Float, Positions, Tensor


@runtime_checkable
class Draper(Protocol):
    """Settles a groom on posed bodies.

    Attributes:
        name: on the command line.
        material: physical parameters of the hair.
    """

    @property
    def name(self) -> str: ...

    @property
    def material(self) -> HairMaterial: ...

    def drape(self, scene: Scene) -> Positions:
        """Draped vertices of every sample [m, world]."""
        ...


@runtime_checkable
class LoadDependentDraper(Draper, Protocol):
    """A draper that reads stiffness, gravity and wind."""

    def with_loading(self, loading: Loading) -> "LoadDependentDraper":
        """The same draper under another loading."""
        ...


@runtime_checkable
class ClipDraper(Draper, Protocol):
    """A draper whose frames depend on those that it draped before.

    Attributes:
        frame_seconds: time from each frame to the next [s].
        is_moving: whether hair has not come to rest in the last frame: another drape of the same frame goes on.
    """

    frame_seconds: float

    @property
    def is_moving(self) -> bool: ...

    def restart(self) -> None:
        """Settle the next frame anew."""
        ...


@runtime_checkable
class ResumableDraper(ClipDraper, Protocol):
    """One that can go on after frames that another process draped.

    Attributes:
        state: what the next frame follows from, a row of numbers of every strand; None before the first frame.
    """

    @property
    def state(self) -> Float[Tensor, "s k"] | None: ...

    def resume(self, scene: Scene, state: Float[Tensor, "s k"]) -> None:
        """Continue from the last of these frames, after which `state` was this, as if it had been draped here."""
        ...


@dataclass(frozen=True)
class StoppingReport:
    """Where an iterative draper stopped.

    Attributes:
        energy: mean energy of the samples [J].
        relative_gradient: of the worst sample, as `quaffure.solvers.stopping` defines it.
        iterations: energy evaluations, of a part of the strands in proportion; sweeps of XPBD; of
            `strand_newton` the passes that led to the shape that is returned.
        seconds: wall time.
    """

    energy: float
    relative_gradient: float
    iterations: int
    seconds: float
