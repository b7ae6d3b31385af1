"""A cache of the most recent values."""

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

T = TypeVar("T")


class Kept(Generic[T]):
    """The most recent values; the key holds everything that a value depends on. Several threads may share one."""

    def __init__(self, most: int) -> None:
        self._most, self._values = most, OrderedDict[Hashable, T]()

    def get(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return the value of a key; compute and keep it on a cache miss."""
        found = self._values.pop(key, None)
        self._values[key] = found = make() if found is None else found
        while len(self._values) > self._most:
            self._values.popitem(last=False)  # in one step, which no other thread can part
        return found
