"""What a registration guessed and found."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from quaffure.hair.file_frame import FileFrame


@dataclass(frozen=True)
class RegistrationReport:
    """Estimates and residuals of a registration.

    Attributes:
        source: the file of the strands.
        unit: of the file: m, cm, mm, inch, or its size where it has no name.
        up_axis, forward_axis: of the file, as in "+y"; the face is turned forward.
        scale: metres in a file unit.
        rotation: from the file's axes to ours; of a left-handed file a reflection as well.
        translation: of what is rotated and scaled [m].
        frame: what was known of the file; the rest was guessed.
        median_residual, p95_residual, max_residual: distance of the aligned roots from the scalp, kept strands [mm].
        kept, dropped: strands; dropped are those of a single point, without length or too far from the scalp.
        beard, eyebrows: strands left out because they grow on the lower face, or above the eyes.
        turned: whether the file stores strands from tip to root.
        turned_strands: strands that it stores the other way round than the others.
        from_tip: whether each strand of the file is stored from tip to root.
        on_scalp: whether each strand of the file stands on the scalp, and is not left out or dropped.
        inside_before, inside_after: share of vertices, without the roots, inside the body: when aligned and at the end.
    """

    source: str
    unit: str
    up_axis: str
    forward_axis: str
    scale: float
    rotation: Float[np.ndarray, "3 3"]
    translation: Float[np.ndarray, "3"]
    frame: FileFrame
    median_residual: float
    p95_residual: float
    max_residual: float
    kept: int
    dropped: int
    beard: int
    eyebrows: int
    turned: bool
    turned_strands: int
    from_tip: Bool[np.ndarray, " s"]
    on_scalp: Bool[np.ndarray, " s"]
    inside_before: float
    inside_after: float

    def __str__(self) -> str:
        return (
            f"{self.source}: {self._axes}{self._turns}; {self.kept} strands kept, {self.dropped} dropped{self._parts}; "
            f"roots {self.median_residual:.1f} mm from the scalp in the median, {self.p95_residual:.1f} mm at 95 %, "
            f"{self.max_residual:.1f} mm at most; {100 * self.inside_before:.2f} % of the vertices inside the body on "
            f"arrival, {100 * self.inside_after:.3f} % now."
        )

    @property
    def _axes(self) -> str:
        axes = f"with {self.up_axis} up, facing {self.forward_axis}"
        read = f"read in {self.unit} {axes} (1 unit = {1e3 * self.scale:.4g} mm)"
        if self.frame.mirror:
            read += ", left-handed"
        if self.frame.registered:
            return f"{read}, on this body as it stands"
        known = {"unit": self.frame.units, "up axis": self.frame.up, "facing": self.frame.forward}
        guessed = [name for name, value in known.items() if not value]
        return f"{read}, guessed: {', '.join(guessed)}" if guessed else read

    @property
    def _turns(self) -> str:
        turned = "; strands stored from tip to root, turned round" if self.turned else ""
        return turned + (f"; {self.turned_strands} single strands turned round" if self.turned_strands else "")

    @property
    def _parts(self) -> str:
        parts = {"a beard": self.beard, "eyebrows": self.eyebrows}
        found = [f"{count} of {part}" for part, count in parts.items() if count]
        return f", and {' and '.join(found)} left out" if found else ""
