"""What is wrong with a drape at first sight: hair inside the body, and tips that jump. Cheap, unlike all metrics."""

import torch

from quaffure.benchmark.appearance import JUMP_SPEED, jumps
from quaffure.energies.body_collision import intersection_percent
from quaffure.scene import HairScene
from quaffure.types import Float, Positions, Tensor

MOST_INSIDE_PERCENT = 0.1
"""Share of a frame's vertices inside the body above which the frame is named: ten times what `strand_newton` leaves in
the mean over the evaluation set."""
MOST_RANGES = 6
"""Ranges of frames that a finding lists."""


class DrapeChecks:
    """Two of the metrics, by the same code, frame by frame as they come.

    Args:
        fps: frames per second, for jumps.
    """

    def __init__(self, fps: float) -> None:
        self._jump = JUMP_SPEED / fps
        self._inside: list[Float[Tensor, " b"]] = []
        self._moved: list[Float[Tensor, "f s"]] = []
        self._last: tuple[Positions, Positions] | None = None

    def add(self, draped: Positions, scene: HairScene) -> None:
        """Check the next frames, which follow those added before."""
        self._inside.append(intersection_percent(draped, scene))
        hair = draped, scene.posed
        consecutive = hair if self._last is None else [torch.cat(parts) for parts in zip(self._last, hair)]
        self._moved.append(jumps(*consecutive))
        self._last = draped[-1:], scene.posed[-1:]

    @property
    def inside_percent(self) -> list[float]:
        """`body_intersection_percent` of every frame [%]."""
        found: list[float] = torch.cat(self._inside).tolist()
        return found

    @property
    def jumping_tips(self) -> list[int]:
        """`jumps` of every frame; none lead to the first one."""
        found: list[int] = (torch.cat(self._moved) > self._jump).sum(dim=1).tolist()
        return [0, *found]

    def findings(self) -> list[str]:
        """A phrase for each kind of fault, with its frames, counted from 0 in the output; none where there is none."""
        found, tips, inside = [], self.jumping_tips, self.inside_percent
        if frames := [frame for frame, count in enumerate(tips) if count]:
            count = sum(tips)
            found.append(f"{frames_named(frames)}: {count} {'tip jumps' if count == 1 else 'tips jump'}")
        if frames := [frame for frame, percent in enumerate(inside) if percent > MOST_INSIDE_PERCENT]:
            most = "" if len(frames) == 1 else "up to "
            found.append(f"{frames_named(frames)}: {most}{max(inside):.2g} % inside")
        return found


def frames_named(frames: list[int]) -> str:
    """Ascending frames as ranges, "frames 3-7, 12"; of many ranges the first ones and how many frames there are."""
    ranges: list[list[int]] = []
    for frame in frames:
        if ranges and ranges[-1][-1] == frame - 1:
            ranges[-1][1:] = [frame]
        else:
            ranges.append([frame])
    listed = ", ".join("-".join(map(str, ends)) for ends in ranges[:MOST_RANGES])
    more = "" if len(ranges) <= MOST_RANGES else f", ... ({len(frames)} in all)"
    return f"{'frame' if len(frames) == 1 else 'frames'} {listed}{more}"
