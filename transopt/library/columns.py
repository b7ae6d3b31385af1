"""The columns in which entries are shown: each is declared once, whatever prints or draws the table.

A build, a library, a check, a study and the design on a nonlinear plant say what they know of an entry as a
`TableRow`; terminal, Markdown report, notebook, `show`, `compare` and `verify` choose columns by name and print the
same cells. A new figure of an entry is one field of `TableRow` and one `Column`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from transopt.base.signals import STANDARD_GRAVITY_M_S2
from transopt.base.writing import percent
from transopt.problem.objective.bands import JUST_NOTICED_dB

NAN = float("nan")
UNKNOWN = "-"  # the cell of a number that is not known, or that a refused entry does not have


@dataclass(frozen=True)
class TableRow:
    """What the columns show of one entry; NaN stands for a number that is not known or not looked at.

    Attributes
    ----------
    place : the entry, in the cells of `Axes.columns`.
    nrmse, floor : error after replay, and that of the same problem without its limits.
    after : error after the waveform, relative to the whole target. after_peak_m_s2 : the largest error there.
    seed, clipped : errors of the two other methods, at the transient limit and at the steady one.
    linear : error of the linear design of a nonlinear plant, as promised and as played there. linear_after : its
        error after the waveform.
    repeatability : trial-to-mean error of the recordings.
    peak_input : largest size of what drives the plant [A or V]. winding_C : the hottest winding of the replay.
    violation : largest excess over a limit [A or V]. relative_gap : of the certificate.
    solve_time_s : wall time of the solver.
    largest_multiplier, binding, verdict, result : words; empty where there are none.
    refusal : why the entry is refused; empty for an entry that stands in a library.
    """

    place: tuple[str, ...]
    nrmse: float = NAN
    floor: float = NAN
    after: float = NAN
    after_peak_m_s2: float = NAN
    seed: tuple[float, float] = (NAN, NAN)
    clipped: tuple[float, float] = (NAN, NAN)
    linear: tuple[float, float] = (NAN, NAN)
    linear_after: float = NAN
    repeatability: float = NAN
    peak_input: float = NAN
    winding_C: float = NAN
    violation: float = NAN
    relative_gap: float = NAN
    solve_time_s: float = NAN
    largest_multiplier: str = ""
    binding: str = ""
    verdict: str = ""
    result: str = ""
    refusal: str = ""


@dataclass(frozen=True)
class Column:
    """Declaration of one column.

    Attributes
    ----------
    head : what stands above it; `{unit}` is that of the commands, `{at}` the transient and the steady limit.
    cell : what stands in it.
    meaning : a sentence for the legend; empty where the head says it. `{input}` is what drives the plant, `{target}`
        what is tracked.
    is_number : whether it is set to the right, and empty for a refused entry.
    """

    head: str
    cell: Callable[[TableRow], str]
    meaning: str = ""
    is_number: bool = True


def fixed(value: float, digits: int, scale: float = 1.0) -> str:
    """A number with so many decimals; a dash for NaN."""
    return UNKNOWN if np.isnan(value) else f"{value * scale:.{digits}f}"


def power(value: float) -> str:
    """A number by its power of ten; a dash for NaN."""
    return UNKNOWN if np.isnan(value) else f"{value:.0e}"


def _pair(values: tuple[float, float]) -> str:
    return " / ".join(percent(value) for value in values)


# In the order in which tables show them.
COLUMNS = {
    "nrmse": Column("NRMSE %", lambda row: percent(row.nrmse), "|a - r| / |r| after replay, r {target}"),
    "floor": Column("floor %", lambda row: percent(row.floor), "the same problem without its limits"),
    "after": Column(
        "after %",
        lambda row: percent(row.after),
        "|a - r| when the waveform is over, relative to the same |r|",
    ),
    "after_peak": Column(
        "after g", lambda row: fixed(row.after_peak_m_s2, 3, 1 / STANDARD_GRAVITY_M_S2), "the largest |a - r| there"
    ),
    "seed": Column("seed % {at}", lambda row: _pair(row.seed), "clipped frequency-domain inversion"),
    "clipped": Column(
        "clipped % {at}",
        lambda row: _pair(row.clipped),
        "the unlimited optimum, its {input} clipped (both keep {input} and command limits only)",
    ),
    "linear": Column(
        "linear % promised / played",
        lambda row: _pair(row.linear),
        "the design for the plant at rest, there and played on the nonlinear plant",
    ),
    "linear_after": Column("after, linear %", lambda row: percent(row.linear_after)),
    "repeats": Column("repeats %", lambda row: percent(row.repeatability), "NRMSE of the recordings to their mean"),
    "peak": Column("peak {unit}", lambda row: fixed(row.peak_input, 3)),
    "winding": Column("winding C", lambda row: fixed(row.winding_C, 2)),
    "largest_multiplier": Column(
        "largest multiplier",
        lambda row: row.largest_multiplier or UNKNOWN,
        "per A, V or K of the limit that binds hardest",
    ),
    "violation": Column("violation {unit}", lambda row: power(row.violation)),
    "gap": Column("gap", lambda row: power(row.relative_gap), "of the certificate, relative to max(J, 1e-3)"),
    "ms": Column("ms", lambda row: fixed(row.solve_time_s, 1, 1e3), "of the solver"),
    "binding": Column("what binds", lambda row: row.refusal or row.binding, is_number=False),
    "result": Column("result", lambda row: row.result, is_number=False),
    "verdict": Column(
        "verdict",
        lambda row: "refused" if row.refusal else row.verdict,
        "weak, strong: energy as vibration is felt, around 275 Hz, beside that of r; "
        f"{JUST_NOTICED_dB:g} dB are just noticed",
        is_number=False,
    ),
}

FULL = ("nrmse", "floor", "after", "after_peak", "seed", "clipped", "repeats", "peak", "ms", "binding", "verdict")
NARROW = ("nrmse", "floor", "peak", "binding", "verdict")  # what decides, for a narrow terminal


@dataclass(frozen=True)
class EntryTable:
    """Rows of entries, with what the heads of their columns depend on.

    Attributes
    ----------
    places : heads of the columns that say which entry a row is (`Axes.columns`).
    names : of the columns of `COLUMNS` that are shown, in their order.
    rows : of the entries.
    unit : of the commands: "A" or "V".
    limits : transient and steady limit on what drives the plant; None where no column needs them.
    """

    places: Sequence[str]
    names: Sequence[str]
    rows: Sequence[TableRow]
    unit: str = ""
    limits: tuple[float, float] | None = None

    @property
    def columns(self) -> list[Column]:
        """The declarations of the columns behind the place."""
        return [COLUMNS[name] for name in self.names]

    @property
    def heads(self) -> list[str]:
        """Heads of all columns."""
        at = "" if self.limits is None else f"at {self.limits[0]:g} / {self.limits[1]:g} {self.unit}"
        return [*self.places, *(column.head.format(unit=self.unit, at=at).strip() for column in self.columns)]

    @property
    def cells(self) -> list[list[str]]:
        """Cells of all rows, below `heads`."""
        return [[*row.place, *self.figures(row)] for row in self.rows]

    def figures(self, row: TableRow) -> list[str]:
        """Cells of one row behind its place."""
        return [UNKNOWN if row.refusal and column.is_number else column.cell(row) for column in self.columns]

    def legend(self, driven_by: str, *, named: bool) -> str:
        """What the columns mean, in one paragraph.

        Parameters
        ----------
        driven_by : what drives the plant: current or voltage. named : whether named targets are tracked, not taps.
        """
        target = "the target" if named else "the motor's share of the recorded tap from contact on"
        said = [(column.head.split(" {at}")[0], column.meaning) for column in self.columns if column.meaning]
        return " ".join(f"{head.removesuffix(' %')}: {meaning}." for head, meaning in said).format(
            target=target, input=driven_by, unit=self.unit
        )
