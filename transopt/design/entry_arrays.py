"""The arrays of a library that are computed from its entries, collected device by device."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from transopt.design.entry import Entry
from transopt.library.multipliers import ARRAYS, multiplier_arrays


class EntryArrays:
    """Values of entries for a library, taken from each device while the motions of its entries are still cached.

    It holds no arrays if an entry is refused, since there is no library then.

    Parameters
    ----------
    rows, devices : numbers of speeds, or targets, and of devices.
    """

    def __init__(self, rows: int, devices: int) -> None:
        self._shape, self._number, self._complete = (rows, devices), 0, True
        self._found = dict[str, Any]()

    def add(self, column: Sequence[Entry]) -> None:
        """Replay and judge all entries of the next device and, if all are admitted, add their values."""
        judged = [entry.admitted for entry in column]
        self._complete &= all(judged)
        if not self._complete:
            return
        for name, array in ARRAYS.items():
            if array.made is None:
                continue
            values = np.array([array.made(entry) for entry in column], dtype=object if array.is_text else float)
            if name not in self._found:
                self._found[name] = np.zeros((*self._shape, *values.shape[1:]), dtype=values.dtype)
            # Memory of zeros that is never written to is not allocated.
            if array.is_text or values.any():
                self._found[name][:, self._number] = values
        self._number += 1

    def arrays(self, entries: Sequence[Sequence[Entry]], further: Sequence[str]) -> dict[str, Any]:
        """The arrays of all entries, which have been added, by name, and those of their multipliers."""
        assert self._complete
        assert self._number == self._shape[1]
        texts = {name: np.array(array.tolist()) for name, array in self._found.items() if ARRAYS[name].is_text}
        multipliers = [[entry.solution.multipliers for entry in row] for row in entries]
        return self._found | texts | multiplier_arrays(multipliers, further)
