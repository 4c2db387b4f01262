"""Reads Biovision hierarchy (BVH) motion: a HIERARCHY of joints, then MOTION with one line of channel values a frame.

There is no standard; this follows what Biovision's own files, MotionBuilder and the conversions of the CMU database
agree on. Joint names may hold spaces; `End Site` blocks mark the ends of bones.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, NoReturn

import numpy as np

from quaffure.body.bvh_clip import CHANNEL_NAMES, BvhClip
from quaffure.errors import InputError
from quaffure.input_file import read_text

MOST_DIGITS = 18
_CANONICAL_CHANNEL = {name.lower(): name for name in CHANNEL_NAMES}


@dataclass
class _Lines:
    """The file's non-empty lines, taken one after another; remembers where it is, for messages."""

    path: Path
    lines: list[tuple[int, str]]
    last: int
    next_index: int = 0

    @property
    def number(self) -> int:
        """Line number of the line taken last."""
        return self.lines[self.next_index - 1][0] if self.next_index else 1

    def take(self, expected: str) -> str:
        if self.next_index >= len(self.lines):
            raise InputError(f"{self.path}, line {self.last}", expected, "the end of the file")
        self.next_index += 1
        return self.lines[self.next_index - 1][1]

    def skip(self, keyword: str) -> None:
        """Pass over a line that is one keyword."""
        if (line := self.take(keyword)).upper() != keyword:
            self.fail(keyword, f"'{line[:40]}'")

    def fail(self, expected: str, found: str) -> NoReturn:
        raise InputError(f"{self.path}, line {self.number}", expected, found)


class _Joint(NamedTuple):
    name: str
    parent: int
    offset: list[float]
    channels: tuple[str, ...]
    end: list[float]  # offset of its End Site; empty without one


def read_bvh(path: str | Path) -> BvhClip:
    """The clip in a BVH file, nothing converted.

    Raises:
        InputError: the file cannot be read, is cut off, has no MOTION, no frames, a frame time that is not positive,
            a line with another number of values than its channels, or a value that is not a finite number. Names
            the line.
    """
    path = Path(path)
    lines = _read_lines(path)
    names, parents, offsets, channels, ends = zip(*_parse_hierarchy(lines))
    frame_count, frame_time = _parse_motion_header(lines)
    values = _parse_frames(lines, frame_count, sum(map(len, channels)))
    return BvhClip(
        joint_names=names,
        parents=np.array(parents, dtype=np.int64),
        offsets=np.array(offsets, dtype=np.float64),
        channels=channels,
        values=values,
        frame_time=frame_time,
        source=str(path),
        ends=np.array([end or [np.nan] * 3 for end in ends]),
    )


def _read_lines(path: Path) -> _Lines:
    text = read_text(path, "a BVH text file", "utf-8-sig")
    lines = [(number, line.strip()) for number, line in enumerate(text.splitlines(), start=1)]
    return _Lines(path, [(number, line) for number, line in lines if line], last=max(len(lines), 1))


def _parse_hierarchy(lines: _Lines) -> list[_Joint]:
    """Joints in file order. A loop with a stack, so that a file nested ten thousand deep is no trap."""
    lines.skip("HIERARCHY")
    joints: list[_Joint] = []
    open_joints: list[int] = []
    names: set[str] = set()
    while open_joints or not joints:
        word, _, rest = lines.take("ROOT" if not joints else "JOINT, End Site or }").partition(" ")
        if word == "}" and open_joints:
            open_joints.pop()
        elif word.upper() == ("JOINT" if open_joints else "ROOT"):
            joints.append(_parse_joint(lines, names, rest.strip(), open_joints[-1] if open_joints else -1))
            names.add(joints[-1].name)
            open_joints.append(len(joints) - 1)
        elif word.upper() == "END" and open_joints:
            lines.skip("{")
            joints[open_joints[-1]].end[:] = _parse_offset(lines)
            lines.skip("}")
        else:
            lines.fail("JOINT, End Site or }" if open_joints else "ROOT and its name", f"'{f'{word} {rest}'[:40]}'")
    return joints


def _parse_joint(lines: _Lines, others: set[str], name: str, parent: int) -> _Joint:
    if not name:
        lines.fail("a joint name", "none")
    if name in others:
        lines.fail("joint names that differ", f"'{name}' twice")
    lines.skip("{")
    return _Joint(name, parent, _parse_offset(lines), _parse_channels(lines), [])


def _parse_offset(lines: _Lines) -> list[float]:
    word, *numbers = lines.take("OFFSET x y z").split()
    if word.upper() != "OFFSET" or len(numbers) != 3:
        lines.fail("OFFSET x y z", f"'{' '.join([word, *numbers])[:40]}'")
    return _finite_numbers(lines, numbers)


def _parse_channels(lines: _Lines) -> tuple[str, ...]:
    word, *entries = lines.take("CHANNELS").split()
    if word.upper() != "CHANNELS" or not entries or not _is_count(entries[0]):
        lines.fail("CHANNELS, their number and names", f"'{' '.join([word, *entries])[:40]}'")
    count, names = int(entries[0]), entries[1:]
    if len(names) != count:
        lines.fail(f"{count} channel names", f"{len(names)}")
    unknown = [name for name in names if name.lower() not in _CANONICAL_CHANNEL]
    if unknown or len({name.lower() for name in names}) != count:
        lines.fail(f"different channels out of {', '.join(CHANNEL_NAMES)}", f"'{' '.join(names)[:80]}'")
    return tuple(_CANONICAL_CHANNEL[name.lower()] for name in names)


def _parse_motion_header(lines: _Lines) -> tuple[int, float]:
    """Number of frames and seconds per frame."""
    lines.skip("MOTION")
    label, _, count = lines.take("Frames: and their number").partition(":")
    if label.strip().lower() != "frames" or not _is_count(count.strip()) or int(count) < 1:
        lines.fail("Frames: and a number above 0", f"'{label}:{count}'"[:60])
    label, _, seconds = lines.take("Frame Time: and its seconds").partition(":")
    if label.strip().lower() != "frame time" or len(seconds.split()) != 1:
        lines.fail("Frame Time: and its seconds", f"'{label}:{seconds}'"[:60])
    frame_time = _finite_numbers(lines, seconds.split())[0]
    if frame_time <= 0.0:
        lines.fail("a frame time above 0 s", f"{frame_time:g}")
    return int(count), frame_time


def _parse_frames(lines: _Lines, frame_count: int, channel_count: int) -> np.ndarray:
    """Channel values [F,C] float64."""
    available = len(lines.lines) - lines.next_index
    if available != frame_count:
        where = f"{lines.path}, line {lines.last}"
        raise InputError(where, f"{frame_count} lines of values as 'Frames:' says", f"{available}")
    values = np.empty((frame_count, channel_count))
    for frame in range(frame_count):
        words = lines.take("channel values").split()
        if len(words) != channel_count:
            lines.fail(f"{channel_count} channel values", f"{len(words)}")
        values[frame] = _finite_numbers(lines, words)
    return values


def _is_count(word: str) -> bool:
    """Whether a word is a whole number. Python converts some thousand digits at most, and no file has so many lines."""
    return word.isdecimal() and len(word) <= MOST_DIGITS


def _finite_numbers(lines: _Lines, words: list[str]) -> list[float]:
    try:
        numbers = [float(word) for word in words]
    except ValueError as error:
        lines.fail("numbers", str(error).removeprefix("could not convert string to float: "))
    if not np.isfinite(numbers).all():
        bad = next(word for word, number in zip(words, numbers) if not np.isfinite(number))
        lines.fail("finite numbers", f"'{bad}'")
    return numbers
