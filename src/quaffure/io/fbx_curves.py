"""Curves of an FBX file: numbers over time, by keys of three kinds."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from quaffure.geometry.hermite import hermite, key_intervals
from quaffure.io.character_limits import LAST_SECOND
from quaffure.io.fbx_document import FbxObject
from quaffure.io.fbx_records import FbxRecord

CONSTANT, CUBIC = 0x2, 0x8
"""Flags of a key whose value lasts to the next one, and of one that a cubic curve begins at; a line at others."""
CONSTANT_NEXT, BY_TENSION = 0x100, 0x200
"""Flags of a constant key that has the value of the next one, and of a cubic key without slopes of its own."""
LINE, STEP, STEP_NEXT, SPLINE = range(4)
KEY_NUMBERS = 4
"""Numbers of a key: slope after it, slope before the next one, and what is not used here, weights and velocities."""
BYTES_A_CURVE, BYTES_A_KEY, BYTES_WHILE_READ = 2000, 40, 150  # kept, and of a key while it is read


@dataclass(frozen=True, eq=False)
class FbxCurve:
    """A number over time; before the first key and after the last it stays.

    Attributes:
        times: of the keys [s], not decreasing.
        values: at the keys, in the unit of the property [units of the file, degrees, factors or percent].
        kinds: of the curve from each key to the next: `LINE`, `STEP`, `STEP_NEXT` or `SPLINE`.
        slopes: after each key, and before the next one [unit of the values per second].
    """

    times: Float[np.ndarray, " k"]
    values: Float[np.ndarray, " k"]
    kinds: Int[np.ndarray, " k"]
    slopes: Float[np.ndarray, "k 2"]

    def at(self, times: Float[np.ndarray, " f"], is_before: bool) -> Float[np.ndarray, " f"]:
        """Values at some times [s].

        Args:
            is_before: just before each time, where the value jumps, or just after it.
        """
        key, following, seconds, share = key_intervals(self.times, times, "left" if is_before else "right")
        start, end, kind = self.values[key], self.values[following], self.kinds[key]
        found = start + share * (end - start)
        found = np.where(kind == STEP, start, found)
        has_begun = times > self.times[key] if is_before else times >= self.times[key]
        found = np.where((kind == STEP_NEXT) & has_begun, end, found)
        leaving, arriving = seconds * self.slopes[key, 0], seconds * self.slopes[key, 1]
        return np.where(kind == SPLINE, hermite(share, start, end, leaving, arriving), found)

    def is_still(self, first: Float[np.ndarray, " f"], last: Float[np.ndarray, " f"]) -> np.ndarray:
        """Whether the value is the same from each time to another, between which there is no key [f]."""
        key = key_intervals(self.times, first).before
        is_flat = (self.kinds[key] != SPLINE) | ~self.slopes[key].any(axis=1)
        return is_flat & (self.at(first, False) == self.at(last, True))


def read_curve(curve: FbxObject) -> FbxCurve | None:
    """A curve; None of one without keys.

    Raises:
        InputError: times that decrease, or another number of values than of keys.
    """
    record = curve.record
    listed = record.child("KeyTime")
    if listed is None or not listed.values:
        return None
    ticks, values = listed.integers(), record.required("KeyValueFloat").floats(1)[:, 0]
    record.reserve(BYTES_A_CURVE + BYTES_A_KEY * len(ticks))
    record.reserve(BYTES_WHILE_READ * len(ticks), is_kept=False)
    times = ticks / record.file.ticks_per_second
    if len(values) != len(ticks):
        record.fail(f"{len(ticks)} values, as many as keys", f"{len(values)}")
    if not len(ticks):
        return None
    if (np.diff(times) < 0).any() or not (np.abs(times) <= LAST_SECOND).all():
        record.fail(f"times that do not decrease, within {LAST_SECOND:g} s", "others")
    kinds, slopes = _kinds(record, len(ticks))
    return FbxCurve(times, values, kinds, slopes)


def _kinds(record: FbxRecord, count: int) -> tuple[Int[np.ndarray, " k"], Float[np.ndarray, "k 2"]]:
    """Kind and slopes of every key. Keys that follow one another share what is the same."""
    kinds, slopes = np.full(count, LINE), np.zeros((count, 2))
    flags, counts = record.child("KeyAttrFlags"), record.child("KeyAttrRefCount")
    if flags is None or counts is None or not flags.values or not counts.values:
        return kinds, slopes
    bits, repeats = flags.integers(), counts.integers()
    if len(bits) != len(repeats) or (repeats < 0).any() or (repeats > count).any() or repeats.sum() != count:
        record.fail(f"flags of {count} keys", "others")
    numbers, groups = record.child("KeyAttrDataFloat"), len(bits)
    bits = np.repeat(bits, repeats)
    if numbers is not None and numbers.values:
        slopes = np.repeat(_slopes(numbers, groups), repeats, axis=0)
        kinds[(bits & CUBIC != 0) & (bits & BY_TENSION == 0)] = SPLINE
    is_constant = bits & CONSTANT != 0
    kinds[is_constant] = np.where(bits[is_constant] & CONSTANT_NEXT, STEP_NEXT, STEP)
    return kinds, slopes


def _slopes(record: FbxRecord, count: int) -> Float[np.ndarray, "n 2"]:
    """The first two of the four numbers that each kind of key has. What is not used may be any bits."""
    numbers = record.numbers()
    if numbers.size != KEY_NUMBERS * count:
        record.fail(f"{KEY_NUMBERS * count} numbers", f"{numbers.size}")
    slopes = numbers.reshape(-1, KEY_NUMBERS)[:, :2].astype(np.float64)
    return record.within(slopes)
