"""What is computed of a groom once, and computed again when its arrays have been changed in place."""

from collections.abc import Callable
from typing import Generic, TypeVar
from weakref import WeakKeyDictionary, ref

import torch

from quaffure.hair.groom import Groom

Value = TypeVar("Value")


class GroomCopy:
    """Copies of a groom's arrays, to find out later whether it is still the same; the groom itself is not kept alive.

    Torch's counters of changes in place are not enough: numpy's views of a tensor do not raise them.
    """

    def __init__(self, groom: Groom) -> None:
        self._groom = ref(groom)
        self._arrays = {name: array.detach().clone() for name, array in groom.arrays().items()}

    def is_of(self, groom: Groom) -> bool:
        """Whether this is the groom that was copied, and every array has the values that it had."""
        if self._groom() is not groom:
            return False
        now = groom.arrays()
        return all(map(torch.equal, now.values(), self._arrays.values()))


class GroomCache(Generic[Value]):
    """Values by groom, kept as long as the groom is. They must not refer to it."""

    def __init__(self) -> None:
        self._kept: WeakKeyDictionary[Groom, tuple[GroomCopy, Value]] = WeakKeyDictionary()

    def of(self, groom: Groom, make: Callable[[], Value]) -> Value:
        """The value that is kept for a groom with these very arrays, or one that is made, and kept from now on."""
        kept = self._kept.get(groom)
        if kept is None or not kept[0].is_of(groom):
            kept = self._kept[groom] = GroomCopy(groom), make()
        return kept[1]
