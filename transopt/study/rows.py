"""One row of a study: its columns, what its cells hold, and what the rows of a study amount to.

A column is declared once, with what a solved entry has in it; store, rows.csv, tables and questions read its name.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from transopt.design.entry import Entry
from transopt.problem.answer import Status
from transopt.problem.limits import KINDS
from transopt.problem.limits.supply import SupplyLimit
from transopt.proof.certify import boxes_of
from transopt.study.axes import label

REFUSED = "REFUSED"  # beside the names of Status: the scene itself is invalid
DEFECT = "DEFECT"  # a solve that ended in an exception that no input should cause
NAN = float("nan")
# Label of a limit -> column of its largest multiplier.
MULTIPLIER_COLUMNS = {kind.label: f"mu_{kind.label}_1_{kind.base_unit()}" for kind in KINDS}


def _multiplier(kind_label: str) -> Callable[[Entry], float]:
    """The largest multiplier of a limit; NaN where the problem does not have it, or the command is not finite."""

    def largest(entry: Entry) -> float:
        if not np.all(np.isfinite(entry.solution.command)):
            return NAN
        boxes = boxes_of(entry.designed.effect, entry.solution.multipliers)
        own = [box for box in boxes if box.limit.label == kind_label]
        return max((float(np.maximum(box.by_upper, box.by_lower).max()) for box in own), default=NAN)

    return largest


def _made_dB(entry: Entry) -> float:
    """Energy in the last term of the error over the target's; NaN of a zero reference."""
    problem = entry.problem
    effect = entry.designed.effect
    return NAN if problem.reference_is_zero else problem.tracking.energy_dB(effect.accelerations_m_s2)


# What a solved entry has in each column, in their order; the number of the row stands before them. NaN and empty text
# are empty cells.
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
    "energy_dB": _made_dB,
    # The nearest waveform has this energy; the same as energy_dB where the scene asks for no energy.
    "waveform_dB": lambda e: _made_dB(e) if e.attained is None else e.attained.waveform_dB,
    # The price of the energy: 0 where the scene asks for none, or the nearest waveform has it.
    "intensity": lambda e: NAN if e.problem.reference_is_zero else e.problem.intensity,
    "free_peak": lambda e: e.free_peak,
    "peak_input": lambda e: e.played.peak_input,
    "peak_command": lambda e: e.played.peak_command,
    "peak_temperature_C": lambda e: e.played.winding_C,
    "peak_voltage_V": lambda e: e.played.reached.get(SupplyLimit.name, NAN),
    "objective": lambda e: e.certificate.objective,
    "relative_gap": lambda e: e.certificate.relative_gap,
    "relative_bound": lambda e: e.certificate.relative_bound,
    "violation_A": lambda e: e.certificate.violation("A"),
    "violation_V": lambda e: e.certificate.violation("V"),
    "violation_K": lambda e: e.certificate.violation("K"),
    **{column: _multiplier(kind_label) for kind_label, column in MULTIPLIER_COLUMNS.items()},
    "tap_error_seed": lambda e: e.baselines.seed.tap_error,
    "tap_error_clipped": lambda e: e.baselines.clipped.tap_error,
    "binding": lambda e: e.binding,
    "price": lambda e: "; ".join(one.sentence for one in e.prices),
    "solver": lambda e: e.solution.solver,
    "reason": lambda e: "; ".join(e.shortfalls),
    "solve_ms": lambda e: 1e3 * e.solution.solve_time_s,
    "total_ms": lambda _: NAN,  # the share of the entry in the time of its task, which the task knows
}
# The columns that cost more than the optimum: baselines at the transient limit, and prices of the binding limits.
RIVALS = {"tap_error_seed", "tap_error_clipped", "price"}
# How far the certificate found a limit exceeded, a column per unit of the limits.
VIOLATIONS = ("violation_A", "violation_V", "violation_K")
# What an inverse question may require a bound of.
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
OPTIMAL = Status.OPTIMAL.name
# What a study may well come upon when it varies a scene: the row says that there is no such optimum, and why. Any
# other status but OPTIMAL is a solver or a proof that fell short.
REFUSALS = {
    REFUSED,
    *(
        status.name
        for status in (Status.INFEASIBLE, Status.HAND_OVER, Status.UNSTABLE_WALL, Status.UNRESOLVED, Status.PRECISION)
    ),
}
Outcome = dict[str, Any]
"""What one entry came to: its number under "index", and a value for each column of `COLUMNS` that it has."""
Row = dict[str, str]


def outcome_of(entry: Entry, index: int, *, rivals: bool) -> Outcome:
    """All columns of a solved entry; those of `RIVALS` only where they are asked for."""
    return {"index": index, **{name: made(entry) for name, made in COLUMNS.items() if rivals or name not in RIVALS}}


def _cell(value: Any) -> str:
    """A value on one line; empty where there is none."""
    if isinstance(value, float) and np.isnan(value):
        return ""
    return " ".join(label(value).split())


def row_of(outcome: Outcome, point: int, labels: Mapping[str, str]) -> Row:
    """The row of an outcome: its number, the number of its point, the varied values, and what came out."""
    cells = {name: _cell(outcome.get(name, "")) for name in COLUMNS}
    varied = {key: " ".join(text.split()) for key, text in labels.items()}
    return {"index": str(outcome["index"]), "point": str(point), **varied, **cells}


def number(row: Row, column: str) -> float:
    """A cell as a number, NaN where it is empty."""
    return float(row[column]) if row[column] else NAN


def entry_name(row: Row) -> str:
    """How messages and tables call the entry of a row."""
    return row["target"] or f"{float(row['speed_m_s']):g} m/s, {float(row['grip_N']):g} N"


def entry_cells(row: Row) -> list[str]:
    """Which entry a row is of, in the columns of a table (`Axes.columns`)."""
    return [row["target"]] if row["target"] else [f"{float(row['speed_m_s']):g}", f"{float(row['grip_N']):g}"]


def exit_code(rows: Sequence[Row]) -> int:
    """0 if every row is certified or a refusal, and one at least is certified; else 1."""
    found = {row["status"] for row in rows}
    return 0 if OPTIMAL in found and found <= {OPTIMAL, *REFUSALS} else 1
