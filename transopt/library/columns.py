"""The columns of tables of entries, each declared once for everything that prints or draws such a table.

Entries of a build, of a library, of a check and of a study are rows (`Row`). The terminal, Markdown report, notebook,
`show`, `compare`, `verify` and the page choose columns by name and so print the same cells.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from transopt.base.signals import STANDARD_GRAVITY_M_S2
from transopt.base.writing import percent
from transopt.problem.objective.bands import JUST_NOTICED_dB

NAN = float("nan")
PAIR = (NAN, NAN)
UNKNOWN = "-"  # cell of a number that is unknown, or of a refused entry


class Row(Protocol):
    """One entry as tables read it; a figure is computed only when its column is shown."""

    @property
    def cells(self) -> Sequence[str]:
        """Cells of the columns `Axes.columns`, which say which entry it is."""

    @property
    def refusal(self) -> str:
        """Why the entry is refused; empty for an entry whose figures are shown."""

    def value(self, column: str) -> Any:
        """The entry's value in a column of `COLUMNS`; NaN or empty if it is unknown or was not computed."""


@dataclass(frozen=True)
class TableRow:
    """A row whose values are all computed in advance.

    Attributes
    ----------
    cells, refusal : see `Row`.
    values : column -> value; columns that are missing have their unknown value.
    """

    cells: Sequence[str]
    values: Mapping[str, Any] = field(default_factory=dict)
    refusal: str = ""

    def value(self, column: str) -> Any:
        """The entry's value in a column."""
        return self.values.get(column, COLUMNS[column].unknown)


@dataclass(frozen=True)
class Column:
    """Declaration of one column.

    Attributes
    ----------
    head : head of the column; `{unit}` is the unit of the commands, `{at}` the transient and the steady limit.
    show : turns a value into the cell's text.
    meaning : explanation for the legend; empty if the head says enough. `{input}` is the quantity that drives the
        plant, `{target}` what is tracked, `{over}` the time span, `{ends}` why the error is not 0 even without
        limits.
    unknown : value of an entry for which the column is unknown. Its type sets the alignment: a column of text is
        aligned to the left, one of numbers to the right; a refused entry shows no numbers.
    array : array of `Library` that holds the column, and whose declaration says how an entry's value is computed
        (`Array.made`); empty for a column that no file holds.
    after : whether it concerns the motion after the waveform; unknown if the problem has no samples there.
    """

    head: str
    show: Callable[[Any], str]
    meaning: str = ""
    unknown: Any = NAN
    array: str = ""
    after: bool = False

    @property
    def is_number(self) -> bool:
        """Whether it is aligned to the right and left out for a refused entry."""
        return not isinstance(self.unknown, str)


def fixed(value: float, digits: int, scale: float = 1.0) -> str:
    """A number with this many decimals; a dash for NaN."""
    return UNKNOWN if np.isnan(value) else f"{value * scale:.{digits}f}"


def power(value: float) -> str:
    """A number with one significant digit, with its power of ten; a dash for NaN."""
    return UNKNOWN if np.isnan(value) else f"{value:.0e}"


def _pair(values: tuple[float, float]) -> str:
    return " / ".join(percent(value) for value in values)


def _heat(A2_s: float) -> str:
    """A2 ms; whole ones from ten on, and hundredths of what the coil of a small actuator takes."""
    return fixed(A2_s, 2 if A2_s < 9.5e-3 else 0, 1e3)


# In the order of the tables.
COLUMNS = {
    "tap": Column(
        "tap %",
        percent,
        "error of the stylus' acceleration beside {target}, {over}, after replay",
        array="tap_error",
    ),
    "floor": Column("floor %", percent, "the same error without any limit{ends}", array="floor"),
    "felt": Column("felt %", percent, "the same error from 120 to 620 Hz, where fingers feel", array="felt_error"),
    "felt_dB": Column(
        "felt dB",
        lambda dB: fixed(dB, 2),
        f"energy in that band beside the recorded one; {JUST_NOTICED_dB:g} dB are just noticed",
        array="felt_dB",
    ),
    "speed": Column(
        "speed",
        lambda share: fixed(share, 2),
        "change of the stylus' speed beside the recorded one: 1 is as hard, below 0 the surface pulls",
        array="speed_change",
    ),
    "across": Column(
        "across %",
        percent,
        "error across the normal over the intention, over |r| along it",
        array="tangential_error",
    ),
    "angle": Column(
        "off normal deg",
        lambda rad: fixed(rad, 1, 180 / np.pi),
        "angle by which that error turns the acceleration, by the sizes of both",
        array="direction_rad",
    ),
    "bump": Column(
        "bump g",
        lambda m_s2: fixed(m_s2, 2, 1 / STANDARD_GRAVITY_M_S2),
        "peak error from 10 to 60 Hz afterwards, when the surface lets go",
        array="bump_m_s2",
    ),
    "heat": Column("heat A2ms", _heat, "integral of the squared current over the window", array="heat_A2_s"),
    "after": Column(
        "after %",
        percent,
        "|a - r| when the waveform is over, relative to the same |r|",
        array="error_after",
        after=True,
    ),
    "after_peak": Column(
        "after g",
        lambda m_s2: fixed(m_s2, 3, 1 / STANDARD_GRAVITY_M_S2),
        "the largest |a - r| there",
        array="peak_after_m_s2",
        after=True,
    ),
    "seed": Column("seed % {at}", _pair, "clipped frequency-domain inversion", PAIR),
    "clipped": Column(
        "clipped % {at}",
        _pair,
        "the unlimited optimum, its {input} clipped (both keep {input} and command limits only)",
        PAIR,
    ),
    "linear": Column(
        "linear % promised / played",
        _pair,
        "the design for the plant at rest, there and played on the nonlinear plant",
        PAIR,
    ),
    "linear_after": Column("after, linear %", percent),
    "repeats": Column("repeats %", percent, "error of the recordings beside their mean"),
    "peak": Column("peak {unit}", lambda value: fixed(value, 3), array="peak_input"),
    "winding": Column("winding C", lambda value: fixed(value, 2), array="peak_temperature_C"),
    "largest_multiplier": Column(
        "largest multiplier",
        lambda said: said if isinstance(said, str) else UNKNOWN,
        "per unit of the limit that binds hardest",
    ),
    "violation": Column("violation {unit}", power, array="primal_violation"),
    "gap": Column("gap", power, "of the certificate, relative to max(J, 1e-3)"),
    "ms": Column("ms", lambda seconds: fixed(seconds, 1, 1e3), "of the solver", array="solve_time_s"),
    "binding": Column("what binds", str, unknown="", array="binding"),
    "held": Column("held back by", str, "the binding limits that cost tap error or J", unknown=""),
    "result": Column("result", str, unknown=""),
    "verdict": Column(
        "verdict",
        str,
        "what a hand notices, and what holds the entry back",
        unknown="",
    ),
}

FIGURES = ("tap", "felt", "felt_dB", "speed", "bump", "heat")  # shown for an entry in every table
OF_DIRECTIONS = ("across", "angle")  # only for an arm
FULL = (
    "tap",
    "floor",
    *FIGURES[1:],
    *OF_DIRECTIONS,
    "after",
    "after_peak",
    "repeats",
    "peak",
    "winding",
    "ms",
    "binding",
    "verdict",
)
RIVALS = ("seed", "clipped")  # errors of other methods, shown in the full report


@dataclass(frozen=True)
class EntryTable:
    """Rows of entries, and the values that their columns' heads contain.

    Attributes
    ----------
    places : heads of the columns that say which entry a row is (`Axes.columns`).
    names : names in `COLUMNS` of the columns shown, in order.
    rows : the entries.
    unit : unit of the commands: "A" or "V".
    limits : transient and steady limit on the plant input; None if no column needs them.
    """

    places: Sequence[str]
    names: Sequence[str]
    rows: Sequence[Row]
    unit: str = ""
    limits: tuple[float, float] | None = None

    @property
    def columns(self) -> list[Column]:
        """The declarations of the columns after those of `places`."""
        return [COLUMNS[name] for name in self.names]

    @property
    def heads(self) -> list[str]:
        """Heads of all columns."""
        at = "" if self.limits is None else f"at {self.limits[0]:g} / {self.limits[1]:g} {self.unit}"
        return [*self.places, *(column.head.format(unit=self.unit, at=at).strip() for column in self.columns)]

    @property
    def cells(self) -> list[list[str]]:
        """Cells of all rows, below `heads`."""
        return [[*row.cells, *self.figures(row)] for row in self.rows]

    def figures(self, row: Row) -> list[str]:
        """Cells of one row after those of `places`."""
        if not row.refusal:
            return [COLUMNS[name].show(row.value(name)) for name in self.names]
        said = {"binding": row.refusal, "verdict": "refused"}
        return [UNKNOWN if COLUMNS[name].is_number else said.get(name, "") for name in self.names]

    @property
    def known(self) -> "EntryTable":
        """This table without the numeric columns that are unknown in every row."""

        def is_known(value: Any) -> bool:
            return any(not np.isnan(each) for each in (value if isinstance(value, tuple) else (value,)))

        shown = [row for row in self.rows if not row.refusal]
        names = [
            name
            for name in self.names
            if not COLUMNS[name].is_number or not shown or any(is_known(row.value(name)) for row in shown)
        ]
        return replace(self, names=names)

    def legend(self, driven_by: str, *, named: bool) -> str:
        """The meanings of the columns in one paragraph; parameters as in `meanings`."""
        said = self.meanings(driven_by, named=named)
        return " ".join(f"{head.removesuffix(' %')}: {meaning}." for head, meaning in said.items())

    def meanings(self, driven_by: str, *, named: bool) -> dict[str, str]:
        """Head of a column -> its meaning, for the columns whose head does not say enough.

        Parameters
        ----------
        driven_by : the plant input: current or voltage. named : whether named targets are tracked instead of taps.
        """
        target, over = ("the target", "over the waveform") if named else ("the recorded tap", "over the intention")
        ends = "" if named else ": the waveform ends while the hand pushes"
        words = {"target": target, "over": over, "ends": ends, "input": driven_by, "unit": self.unit}
        said = [(column.head.split(" {at}")[0], column.meaning) for column in self.columns if column.meaning]
        return {head.format(**words): meaning.format(**words) for head, meaning in said}
