"""The arrays of a library that are computed from its entries, collected device by device."""

import math
import mmap
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from transopt.base.signals import FloatArray
from transopt.design.entry import Entry
from transopt.library.multipliers import ARRAYS, MULTIPLIERS, of_sides, pairs_of
from transopt.problem.answer import Multipliers


def _mostly_zeros(shape: tuple[int, ...]) -> FloatArray:
    """Zeros of which a write allocates one page; numpy asks for pages so large that one holds dozens of entries."""
    count = math.prod(shape)
    memory = mmap.mmap(-1, max(count * np.dtype(float).itemsize, 1), access=mmap.ACCESS_COPY)
    return np.frombuffer(memory, dtype=float, count=count).reshape(shape)


class EntryArrays:
    """Values of entries for a library, taken from each device while the motions of its entries are still cached.

    It holds no arrays if an entry is refused, since there is no library then.

    Parameters
    ----------
    rows, devices : numbers of speeds, or targets, and of devices.
    without : names of arrays that are not collected, since they exist already.
    """

    def __init__(self, rows: int, devices: int, without: Collection[str] = ()) -> None:
        self.shape, self._count, self._complete = (rows, devices), 0, True
        self._made = {
            name: (array.made, array.is_text)
            for name, array in ARRAYS.items()
            if array.made is not None and name not in without
        }
        self._found = dict[str, Any]()

    def add(self, entries: Sequence[Entry]) -> None:
        """Replay and judge the next entries, add their values if all are admitted, and free their courses.

        Parameters
        ----------
        entries : of one device, in the order of their rows; those of the next device follow the last row.
        """
        judged = [entry.admitted for entry in entries]
        self._complete &= all(judged)
        if self._complete:
            self._add(entries)
        for entry in entries:
            entry.let_go()

    def _add(self, entries: Sequence[Entry]) -> None:
        device, first = divmod(self._count, self.shape[0])
        for name, (made, is_text) in self._made.items():
            if name == "transient_command" and entries[0].problem.wall is None:
                continue  # it is the command itself
            values: NDArray[Any] = np.array([made(entry) for entry in entries], dtype=object if is_text else float)
            if name not in self._found:
                self._found[name] = np.zeros((*self.shape, *values.shape[1:]), values.dtype)
            # Memory of zeros that is never written to is not allocated.
            if is_text or values.any():
                self._found[name][first : first + len(entries), device] = values
        for row, entry in enumerate(entries, start=first):
            sides = of_sides(entry.solution.multipliers)
            for name, course in sides.items():
                at = np.flatnonzero(course)
                if name not in self._found:
                    self._found[name] = _mostly_zeros((*self.shape, *course.shape))
                self._found[name][row, device, at] = course[at]
            self._share(entry, (row, device), sides)
        self._count += len(entries)

    def _share(self, entry: Entry, at: tuple[int, int], sides: Collection[str]) -> None:
        """Let an entry hold views of the arrays in place of its command and multipliers, which are in memory once."""
        found = {name: array[at] for name, array in self._found.items()}
        designed, answer, multipliers = entry.designed, entry.solution, entry.solution.multipliers
        zero = Multipliers.zero(entry.problem, multipliers.hand_over)
        pairs = pairs_of({name: found[name] for name in sides}, zero.slope)
        slope = found["current_sign"] if multipliers.slope.any() else zero.slope
        if designed.unlimited_command is answer.command:
            vars(designed).update(unlimited_command=found["command"])
        designed.effect.command = found["command"]
        vars(answer).update(command=found["command"], multipliers=replace(zero, pairs=pairs, slope=slope))

    def arrays(self, further: Sequence[str]) -> dict[str, Any]:
        """The arrays of all entries, which have been added, by name, and those of their multipliers above zero.

        Parameters
        ----------
        further : names of multiplier arrays that not every library has (`further_arrays`).
        """
        assert self._complete
        assert self._count == math.prod(self.shape)
        found = self._found
        named = (*self._made, *MULTIPLIERS, *further)
        texts = {name: np.array(found[name].tolist()) for name, (_, is_text) in self._made.items() if is_text}
        same = {"transient_command": found["command"]}
        return same | {name: found[name] for name in named if name in found} | texts
