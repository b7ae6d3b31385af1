"""The content of a file, in any format, before it is checked and converted."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.base.sizes import MOST_ROWS
from transopt.files.names import Meaning
from transopt.files.statements import Rate

LARGEST = 1e12  # in any SI unit: beyond every instrument, yet its square and its slope do not overflow a float
MIN_SAMPLES = 8


@dataclass(frozen=True)
class RawTable:
    """The content of a file, in the file's own units.

    Attributes
    ----------
    columns : name in the file -> (n,) numbers.
    meanings : name in the file -> quantity and unit.
    header : name in the file -> its value, unchecked.
    place : names the place of a sample index in the file, for messages.
    notes : what a user should know about how the columns were found, one sentence each.
    """

    columns: Mapping[str, FloatArray]
    meanings: Mapping[str, Meaning]
    header: Mapping[str, object]
    place: Callable[[int], str]
    notes: tuple[str, ...] = ()

    def rows(self) -> int:
        """Number of rows.

        Raises
        ------
        InputError : the columns differ in length.
        """
        sizes = {name: values.size for name, values in self.columns.items()}
        if len(set(sizes.values())) > 1:
            listed = ", ".join(f"{name} {n}" for name, n in sizes.items())
            raise InputError(f"columns differ in length ({listed} samples); save them equally long")
        return next(iter(sizes.values()))

    def timed(self, rate: Rate) -> "RawTable":
        """The table with a column of times from a rate, before its other columns."""
        size = max((values.size for values in self.columns.values()), default=0)
        times_s = np.asarray(rate.start_s + rate.step_s * np.arange(size), dtype=float)
        meanings = {"time_s": Meaning("time"), **self.meanings}
        columns = {"time_s": times_s, **self.columns}
        return replace(self, columns=columns, meanings=meanings, notes=(*filter(None, [rate.note]), *self.notes))


def check_size(samples: int) -> None:
    """Refuse more samples than a recording may have."""
    if samples > MOST_ROWS:
        raise InputError(f"{samples} samples, at most {MOST_ROWS}; cut the taps out of it")
