"""What a registration guessed and found."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from quaffure.hair.file_frame import FileFrame

FARTHEST_ROOT = 0.035
"""Largest distance of a root from the scalp [m]; others are dropped."""
ROOT_SLACK = 2e-3
"""The same of a groom that stands on this body already [m]."""
MUCH_INSIDE = 0.15
"""Share of the vertices inside the body above which a fit is doubtful."""
LARGEST_MEDIAN_RESIDUAL = 0.012
"""Largest median distance of the roots from the scalp; worse fits are refused [m]."""


class Dropped(NamedTuple):
    """Numbers of strands that are not used, by the reason.

    Attributes:
        too_few_points: of fewer than two points.
        without_length: far shorter than the others.
        too_far: with a root that is too far from the scalp.
    """

    too_few_points: int
    without_length: int
    too_far: int


class HeadFit(NamedTuple):
    """Distances of a groom's own head, above the lowest root, from ours, once it is fitted [mm]."""

    median: float
    p95: float


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
        kept: number of strands.
        unused: strands that are dropped, by the reason; beard and eyebrows are not among them.
        beard, eyebrows: strands left out because they grow on the lower face, or above the eyes.
        turned: whether the file stores strands from tip to root.
        turned_strands: strands that it stores the other way round than the others.
        from_tip: whether each strand of the file is stored from tip to root.
        on_scalp: whether each strand of the file stands on the scalp, and is not left out or dropped.
        inside_before, inside_after: share of vertices, without the roots, inside the body: when aligned and at the end.
        head: how the groom's own head fits ours, where it is given.
        ties: a line on ties, where they were searched for.
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
    unused: Dropped
    beard: int
    eyebrows: int
    turned: bool
    turned_strands: int
    from_tip: Bool[np.ndarray, " s"]
    on_scalp: Bool[np.ndarray, " s"]
    inside_before: float
    inside_after: float
    head: HeadFit | None = None
    ties: str = ""

    @property
    def dropped(self) -> int:
        """Number of strands that are not used, but for a beard and eyebrows."""
        return sum(self.unused)

    def __str__(self) -> str:
        """Eight lines or fewer, for who made the groom."""
        lines = (
            f"{self.source}: {self._axes}", self._strands, self._turns, self._fit, self._head, self._skin,
            self._warning, self.ties,
        )  # fmt: skip
        return "\n".join(line for line in lines if line)

    @property
    def _axes(self) -> str:
        axes = f"with {self.up_axis} up, facing {self.forward_axis}"
        read = f"read in {self.unit} {axes} (1 unit = {1e3 * self.scale:.4g} mm)"
        if self.frame.mirror:
            read += ", left-handed"
        if self.frame.registered:
            return f"{read}, on this body as it stands"
        known = {"unit": self.frame.units, "up axis": self.frame.up, "facing": self.frame.forward}
        options = {"unit": "--units", "up axis": "--up", "facing": "--forward"}
        guessed = [f"{name} ({options[name]})" for name, value in known.items() if not value]
        return f"{read}; guessed: {', '.join(guessed)}" if guessed else read

    @property
    def _strands(self) -> str:
        reach = ROOT_SLACK if self.frame.registered else FARTHEST_ROOT
        total = self.kept + self.dropped + self.beard + self.eyebrows
        reasons = {
            "bald roots (fewer than two points)": self.unused.too_few_points,
            "far shorter than the others": self.unused.without_length,
            f"with a root more than {1e3 * reach:.0f} mm from the scalp": self.unused.too_far,
            "of a beard": self.beard,
            "of eyebrows": self.eyebrows,
        }
        left_out = [f"{count} {reason}" for reason, count in reasons.items() if count]
        return f"strands: {self.kept} of {total} are hair of the scalp" + (
            f"; left out: {', '.join(left_out)}" if left_out else ""
        )

    @property
    def _turns(self) -> str:
        if self.turned:
            single = f", all but {self.turned_strands}" if self.turned_strands else ""
            return f"direction: the file stores strands from tip to root{single}; they are turned round"
        return f"direction: {self.turned_strands} single strands turned round" if self.turned_strands else ""

    @property
    def _fit(self) -> str:
        limit = "" if self.frame.registered else f" (a median above {1e3 * LARGEST_MEDIAN_RESIDUAL:.0f} mm is refused)"
        return (
            f"roots: {self.median_residual:.1f} mm from the scalp in the median, {self.p95_residual:.1f} mm at 95 %, "
            f"{self.max_residual:.1f} mm at most, before they were moved onto it{limit}"
        )

    @property
    def _head(self) -> str:
        if self.head is None:
            return ""
        return (
            f"head: the skull of the head mesh is {self.head.median:.1f} mm from ours in the median, "
            f"{self.head.p95:.1f} mm at 95 %"
        )

    @property
    def _skin(self) -> str:
        return (
            f"skin: {100 * self.inside_before:.2f} % of the points were inside the body; "
            f"{100 * self.inside_after:.3f} % are, now that they are pushed out"
        )

    @property
    def _warning(self) -> str:
        if self.inside_before <= MUCH_INSIDE or self.frame.registered:
            return ""
        cure = "look at the picture of before and after (--picture)"
        if self.head is None:
            cure = f"give the head mesh that the groom was made on (--head), or {cure}"
        return f"warning: {100 * self.inside_before:.0f} % of the points inside the body are many: {cure}"
