"""Text output of reports: Markdown tables, and text and CSV files that are written atomically."""

import csv
import io
import math
from collections.abc import Iterable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from transopt.base.files import whole_file


def table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> list[str]:
    """Lines of a Markdown table, with an empty line below it."""
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return lines + ["| " + " | ".join(str(cell) for cell in row) + " |" for row in rows] + [""]


def write_text(text: str, path: Path) -> None:
    """Write a UTF-8 file atomically; undecodable bytes, as in file names, are written as escapes.

    Raises
    ------
    InputError : the path cannot be written.
    """
    with whole_file(path) as file:
        file.write(text.encode(errors="backslashreplace"))


def write_csv(rows: Sequence[Any], path: Path) -> None:
    """Write a CSV file: one row per dataclass, its fields as columns.

    Raises
    ------
    InputError : the path cannot be written.
    """
    names = [field.name for field in fields(rows[0])]
    write_text(csv_text(names, ([getattr(row, name) for name in names] for row in rows)), path)


def csv_text(columns: Sequence[str], rows: Iterable[Iterable[Any]]) -> str:
    """Rows as CSV text with the column names as header."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(rows)
    return text.getvalue()


def percent(value: float) -> str:
    """A share in percent as text: two decimals if it prints below 10 %, otherwise one; a dash for NaN."""
    return "-" if math.isnan(value) else f"{100 * value:.2f}" if value < 0.09995 else f"{100 * value:.1f}"


def rounded_up(value: float, digits: int = 4) -> float:
    """Round a number >= 0 up to so many digits, so that a printed bound is sufficient."""
    grain = 10.0 ** (math.floor(math.log10(value)) + 1 - digits) if value else 1.0
    return float(f"{math.ceil(value / grain) * grain:.{digits}g}")


def rounded_down(value: float, digits: int = 3) -> float:
    """Round a number > 0 down to so many digits, so that a printed bound is not exceeded."""
    last = digits - 1 - math.floor(math.log10(value))
    below = math.floor(value * 10.0**last) / 10.0**last
    return float(f"{below if below <= value else value:.{digits}g}")
