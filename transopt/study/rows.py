"""One row of a study: its columns, what its cells hold, and what the rows of a study amount to."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from transopt.design.sweep import MULTIPLIER_COLUMNS, REFUSED, Outcome
from transopt.problem.answer import Status
from transopt.study.axes import label


def _outcome() -> list[str]:
    found: list[str] = []
    for field in fields(Outcome):
        found += MULTIPLIER_COLUMNS.values() if field.name == "multipliers" else [field.name]
    return [name for name in found if name != "index"]


# What a solved entry says, in the order of the columns; the number of the row stands before it.
OUTCOME = _outcome()
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
Row = dict[str, str]


def _cell(value: Any) -> str:
    """A value on one line; empty where there is none."""
    if isinstance(value, float) and np.isnan(value):
        return ""
    return " ".join(label(value).split())


def row_of(outcome: Outcome, point: int, labels: Mapping[str, str]) -> Row:
    """The row of an outcome: its number, the number of its point, the varied values, and what came out."""
    values = {**vars(outcome), **dict.fromkeys(MULTIPLIER_COLUMNS.values(), np.nan), **outcome.multipliers}
    cells = {name: _cell(values[name]) for name in OUTCOME}
    varied = {key: " ".join(text.split()) for key, text in labels.items()}
    return {"index": str(outcome.index), "point": str(point), **varied, **cells}


def number(row: Row, column: str) -> float:
    """A cell as a number, NaN where it is empty."""
    return float(row[column]) if row[column] else float("nan")


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
