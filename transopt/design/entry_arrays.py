"""The arrays of a library that are computed from its entries, collected device by device."""

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from transopt.design.entry import Entry
from transopt.library.multipliers import ARRAYS, MULTIPLIERS, of_sides, pairs_of
from transopt.problem.answer import Multipliers


class EntryArrays:
    """Values of entries for a library, taken from each device while the motions of its entries are still cached.

    It holds no arrays if an entry is refused, since there is no library then.

    Parameters
    ----------
    rows, devices : numbers of speeds, or targets, and of devices.
    without : names of arrays that are not collected, since they exist already.
    """

    def __init__(self, rows: int, devices: int, without: Collection[str] = ()) -> None:
        self.shape, self._number, self._complete = (rows, devices), 0, True
        self._made = {
            name: (array.made, array.is_text)
            for name, array in ARRAYS.items()
            if array.made is not None and name not in without
        }
        self._found = dict[str, Any]()

    def add(self, column: Sequence[Entry]) -> None:
        """Replay and judge all entries of the next device, add their values if all are admitted, and free courses.

        Commands and multipliers of the entries then are views of the arrays, so that they are in memory once.
        """
        judged = [entry.admitted for entry in column]
        self._complete &= all(judged)
        if self._complete:
            self._add(column)
            self._number += 1
        for entry in column:
            entry.let_go()
        column[0].batch.let_go()

    def _add(self, column: Sequence[Entry]) -> None:
        # Without a wall there is no feedback beside the transient.
        same = {"transient_command"} if column[0].problem.wall is None else set()
        for name, (made, is_text) in self._made.items():
            if name in same:
                continue
            values: NDArray[Any] = np.array([made(entry) for entry in column], dtype=object if is_text else float)
            found = self._of(name, values.shape[1:], values.dtype)
            # Memory of zeros that is never written to is not allocated.
            if is_text or values.any():
                found[:, self._number] = values
        for row, entry in enumerate(column):
            sides = of_sides(entry.solution.multipliers)
            for name, course in sides.items():
                at = np.flatnonzero(course)
                self._of(name, course.shape)[row, self._number, at] = course[at]
            self._share(entry, row, sides)

    def _of(self, name: str, shape: tuple[int, ...], dtype: Any = float) -> Any:
        """The array of a name, zeros at first, for values of one shape."""
        if name not in self._found:
            self._found[name] = np.zeros((*self.shape, *shape), dtype=dtype)
        return self._found[name]

    def _share(self, entry: Entry, row: int, sides: Collection[str]) -> None:
        """Let an entry hold views of the arrays in place of its own command and multipliers of some `sides`."""
        designed, answer, multipliers = entry.designed, entry.solution, entry.solution.multipliers
        zero = Multipliers.zero(entry.problem, multipliers.hand_over)
        views = {name: self._found[name][row, self._number] for name in (*sides, "command")}
        before, command = answer.command, views.pop("command")
        slope = self._found["current_sign"][row, self._number] if multipliers.slope.any() else zero.slope
        shared = replace(zero, pairs=pairs_of(views, zero.slope), slope=slope)
        vars(answer).update(command=command, multipliers=shared)
        designed.effect.command = command
        if designed.unlimited_command is before:
            vars(designed).update(unlimited_command=command)

    def arrays(self, further: Sequence[str]) -> dict[str, Any]:
        """The arrays of all entries, which have been added, by name, and those of their multipliers above zero.

        Parameters
        ----------
        further : names of multiplier arrays that not every library has (`further_arrays`).
        """
        assert self._complete
        assert self._number == self.shape[1]
        found = self._found
        texts = {name: np.array(found[name].tolist()) for name, (_, is_text) in self._made.items() if is_text}
        sides = {name: found[name] for name in (*MULTIPLIERS, *further) if name in found}
        same = {"transient_command": found.get("transient_command", found["command"])}
        return {name: found[name] for name in self._made if name in found} | same | texts | sides
