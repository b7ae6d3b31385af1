"""Rows of a study: their columns, the content of their cells, and the exit code that follows from them.

Each column is declared once, with its value for a solved entry; store, rows.csv, tables and questions use its name.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from transopt.design.entry import Entry
from transopt.problem.answer import Status
from transopt.problem.limits import KINDS
from transopt.problem.limits.supply import SupplyLimit
from transopt.proof.effect import TEMPERATURE, boxes_of
from transopt.study.axes import label

REFUSED = "REFUSED"  # status beside those of `Status`: the scene itself is invalid
DEFECT = "DEFECT"  # status of a solve that raised an unexpected exception
NAN = float("nan")
LEAST_MULTIPLIER = 1e-9  # per unit of a limit; less is rounding
# Label of a limit -> name of the column with its largest multiplier.
MULTIPLIER_COLUMNS = {kind.label: f"mu_{kind.label}_1_{kind.base_unit()}" for kind in KINDS}


def _multiplier(kind_label: str) -> Callable[[Entry], float]:
    """The largest multiplier of a limit; NaN if the problem lacks the limit or the command is not finite."""

    def largest(entry: Entry) -> float:
        problem, multipliers = entry.problem, entry.solution.multipliers
        own = [row.name for limit, row in problem.rows() if limit.label == kind_label]
        if problem.thermal is not None and problem.thermal.label == kind_label:
            own.append(TEMPERATURE)
        known = own and np.isfinite(entry.solution.command).all()
        return max(map(multipliers.most, own)) if known else NAN

    return largest


def _hardest(entry: Entry) -> str:
    """The limit whose bound would change J most by the same share of it, and its largest multiplier."""
    if not np.all(np.isfinite(entry.solution.command)):
        return ""
    boxes = boxes_of(entry.designed.effect, entry.solution.multipliers, above=LEAST_MULTIPLIER)
    hardest = max(boxes, key=lambda box: float((box.by_upper + box.by_lower).sum()) * box.limit.room, default=None)
    return "" if hardest is None else f"{hardest.name} {np.maximum(hardest.by_upper, hardest.by_lower).max():.2g}"


def _unless_silent(entry: Entry, value: float) -> float:
    """A value that a zero reference does not have: it is NaN there."""
    return NAN if entry.problem.reference_is_zero else value


# Column -> its value for a solved entry, in the order of the file, after the index of the row. NaN and empty text
# give empty cells.
COLUMNS: dict[str, Callable[[Entry], Any]] = {
    "speed_m_s": lambda e: e.speed_m_s,
    "grip_N": lambda e: e.grip_N,
    "target": lambda e: e.target,
    "status": lambda e: e.status.name,
    "tap_error": lambda e: e.figures.tap_error,
    "floor": lambda e: e.floor,
    "felt_error": lambda e: e.figures.felt_error,
    "felt_dB": lambda e: e.figures.felt_dB,
    "speed_change": lambda e: e.figures.speed,
    "bump_m_s2": lambda e: e.figures.bump_m_s2,
    "heat_A2_s": lambda e: e.heat_A2_s,
    "energy_dB": lambda e: _unless_silent(e, e.energy_dB),
    # Energy of the nearest waveform; equal to energy_dB if the scene asks for no energy.
    "waveform_dB": lambda e: _unless_silent(e, e.energy_dB) if e.attained is None else e.attained.waveform_dB,
    # Price lam of the energy: 0 if the scene asks for none or the nearest waveform has it already.
    "intensity": lambda e: _unless_silent(e, e.problem.intensity),
    "free_peak": lambda e: e.free_peak,
    "peak_input": lambda e: e.played.peak_input,
    "peak_command": lambda e: e.played.peak_command,
    "peak_temperature_C": lambda e: e.played.winding_C,
    "peak_voltage_V": lambda e: e.played.reached.get(SupplyLimit.name, NAN),
    "objective": lambda e: e.certificate.objective,
    "relative_gap": lambda e: e.certificate.relative_gap,
    "relative_bound": lambda e: e.certificate.relative_bound,
    "violation": lambda e: e.certificate.primal_violation,
    "violation_A": lambda e: e.certificate.violation("A"),
    "violation_V": lambda e: e.certificate.violation("V"),
    "violation_K": lambda e: e.certificate.violation("K"),
    **{column: _multiplier(kind_label) for kind_label, column in MULTIPLIER_COLUMNS.items()},
    "largest_multiplier": _hardest,
    "tap_error_seed": lambda e: e.baselines.seed.tap_error,
    "tap_error_clipped": lambda e: e.baselines.clipped.tap_error,
    "binding": lambda e: e.binding,
    "price": lambda e: "; ".join(one.sentence for one in e.prices),
    "solver": lambda e: e.solution.solver,
    "reason": lambda e: "; ".join(e.shortfalls),
    "solve_ms": lambda e: 1e3 * e.solution.solve_time_s,
    "total_ms": lambda _: NAN,  # the entry's share of its task's time, which only the task knows
}
# Columns that cost more than the optimum: baselines at the transient limit, and prices of the binding limits.
RIVALS = {"tap_error_seed", "tap_error_clipped", "price"}
# Measures that an inverse question may bound.
MEASURES = (
    "tap_error",
    "felt_error",
    "felt_dB",
    "speed_change",
    "bump_m_s2",
    "heat_A2_s",
    "energy_dB",
    "waveform_dB",
    "intensity",
    "floor",
    "peak_input",
    "peak_command",
    "peak_temperature_C",
    "peak_voltage_V",
    "free_peak",
)
SHARES = ("tap_error", "felt_error", "floor")  # measures stored as shares, and stated and shown in percent
ADMITTED = {status.name for status in Status if status.admitted}
# Expected outcomes of varied scenes: no such optimum exists, and the row says why. Any further status means that a
# solver or a proof fell short.
REFUSALS = {
    REFUSED,
    *(
        status.name
        for status in (Status.INFEASIBLE, Status.HAND_OVER, Status.UNSTABLE_WALL, Status.UNRESOLVED, Status.PRECISION)
    ),
}
# Columns that an entry without a certified optimum lacks: its command is no answer, and so are its figures.
OF_ANSWER = {
    *(measure for measure in MEASURES if measure not in ("floor", "free_peak")),
    *MULTIPLIER_COLUMNS.values(),
    *("objective", "largest_multiplier", "binding", "price"),
}
Outcome = dict[str, Any]
"""What one entry came to: its number under "index", and a value for each column of `COLUMNS` that it has."""
Row = dict[str, str]


def outcome_of(entry: Entry, index: int, *, rivals: bool) -> Outcome:
    """All columns of a solved entry; those of `RIVALS` only if wanted, and of `OF_ANSWER` only if it is admitted."""
    lacks = (set() if rivals else RIVALS) | (set() if entry.status.admitted else OF_ANSWER)
    return {"index": index, **{name: made(entry) for name, made in COLUMNS.items() if name not in lacks}}


def _cell(value: Any) -> str:
    """A value as one line of text; empty for NaN."""
    if isinstance(value, float):
        return "" if math.isnan(value) else label(value)
    return " ".join(label(value).split())


def row_of(outcome: Outcome, point: int, labels: Mapping[str, str]) -> Row:
    """The row of an outcome: its index, the index of its point, the varied values, and the columns."""
    cells = {name: _cell(outcome.get(name, "")) for name in COLUMNS}
    varied = {key: " ".join(text.split()) for key, text in labels.items()}
    return {"index": str(outcome["index"]), "point": str(point), **varied, **cells}


def is_admitted(row: Row) -> bool:
    """Whether the row's answer is proven and replayed within its limits."""
    return row["status"] in ADMITTED


def number(row: Row, column: str) -> float:
    """A cell as a number; NaN if it is empty."""
    return float(row[column]) if row[column] else NAN


def entry_name(row: Row) -> str:
    """Name of a row's entry in messages and tables."""
    return row["target"] or f"{float(row['speed_m_s']):g} m/s, {float(row['grip_N']):g} N"


def entry_cells(row: Row) -> list[str]:
    """Cells that identify a row's entry in a table (`Axes.columns`)."""
    return [row["target"]] if row["target"] else [f"{float(row['speed_m_s']):g}", f"{float(row['grip_N']):g}"]


def exit_code(rows: Sequence[Row]) -> int:
    """0 if every row is certified or a refusal and at least one is certified; else 1."""
    found = {row["status"] for row in rows}
    return 0 if found & ADMITTED and found <= ADMITTED | REFUSALS else 1
