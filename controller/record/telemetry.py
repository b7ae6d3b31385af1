"""Telemetry of a run, tick by tick, to CSV and NPZ that are whole at any moment.

The CSV grows by blocks of complete lines, each block one write; a reader drops what stands after the last line end.
The NPZ is replaced as a whole (written beside its place, renamed over it) each time the run has become a quarter
longer, so that all rewriting together costs no more than a few times the final file.
"""

import os
from collections.abc import Iterable
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controller.servo.interface import Output, Readings
from transopt.base.errors import InputError
from transopt.base.files import whole_file

CSV_NAME, NPZ_NAME = "telemetry.csv", "telemetry.npz"
COLUMNS = (
    "tick",
    "time_s",
    "encoder_counts",
    "grip_N",
    "measured_current_A",
    "measured_acceleration_m_s2",
    "emergency_stop",
    "command_A",
    "state",
    "transient_A",
    "feedback_A",
    "winding_C",
    "events",
)
WHOLE_NUMBERS = ("tick", "emergency_stop")  # a broken encoder may give no number
TEXTS = ("state", "events")
BLOCK_TICKS = 1000
GROWTH = 1.25

Record = tuple[int | float | str, ...]


def _record(readings: Readings, output: Output, dt_s: float) -> Record:
    return (
        readings.tick,
        readings.tick * dt_s,
        readings.encoder_counts,
        readings.grip_N,
        readings.current_A,
        readings.acceleration_m_s2,
        int(readings.emergency_stop),
        output.command_A,
        output.state.value,
        output.transient_A,
        output.feedback_A,
        output.winding_C,
        ";".join(event.what.name.lower() for event in output.events),
    )


def _line(record: Record) -> str:
    # repr of a float is the shortest text that reads back as the same number.
    return ",".join(repr(value) if isinstance(value, float) else str(value) for value in record) + "\n"


def line_of(readings: Readings, output: Output, dt_s: float) -> str:
    """One line of the CSV."""
    return _line(_record(readings, output, dt_s))


def _columns(records: Iterable[Record]) -> dict[str, NDArray[Any]]:
    by_column = list(zip(*records, strict=True)) or [()] * len(COLUMNS)
    kinds: dict[str, type] = {**dict.fromkeys(WHOLE_NUMBERS, np.int64), **dict.fromkeys(TEXTS, np.str_)}
    return {
        name: np.array(values, dtype=kinds.get(name, np.float64))
        for name, values in zip(COLUMNS, by_column, strict=True)
    }


class Telemetry:
    """Writes one run's records into a folder; use it as a context manager, and `record` as a loop's observer.

    Parameters
    ----------
    block_ticks : records per write.

    Raises
    ------
    InputError : the folder cannot be written.
    """

    def __init__(self, folder: Path, dt_s: float, *, block_ticks: int = BLOCK_TICKS) -> None:
        self._folder, self._dt_s, self._block_ticks = folder, dt_s, block_ticks
        self._records: list[Record] = []
        self._written = 0  # records in the CSV
        self._stored = 0  # records in the NPZ
        try:
            folder.mkdir(parents=True, exist_ok=True)
            # An NPZ of an earlier run must not be taken for this one's.
            (folder / NPZ_NAME).unlink(missing_ok=True)
            self._csv = os.open(folder / CSV_NAME, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND, 0o644)
        except OSError as error:
            raise InputError(f"{folder}: cannot be written ({error.strerror}); choose another folder") from None
        self._append((",".join(COLUMNS) + "\n").encode("ascii"))

    def record(self, readings: Readings, output: Output) -> None:
        self._records.append(_record(readings, output, self._dt_s))
        if len(self._records) - self._written >= self._block_ticks:
            self.flush()

    def flush(self) -> None:
        """Bring the CSV up to date, and the NPZ if it lags far behind."""
        lines = "".join(_line(record) for record in self._records[self._written :])
        self._written = len(self._records)
        self._append(lines.encode("ascii"))
        if len(self._records) >= GROWTH * self._stored:
            self._store()

    def close(self) -> None:
        """Both files complete."""
        self.flush()
        self._store()
        os.close(self._csv)

    def __enter__(self) -> "Telemetry":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _append(self, block: bytes) -> None:
        try:
            while block:
                block = block[os.write(self._csv, block) :]
        except OSError as error:
            path = self._folder / CSV_NAME
            raise InputError(f"{path}: cannot be written ({error.strerror}); choose another folder") from None

    def _store(self) -> None:
        with whole_file(self._folder / NPZ_NAME) as file:
            np.savez(file, **_columns(self._records))  # type: ignore[arg-type]
        self._stored = len(self._records)


def read_csv(path: Path) -> dict[str, NDArray[Any]]:
    """Columns of a telemetry CSV, of a running or a killed run too: a line without its end is left out.

    Raises
    ------
    InputError : not a telemetry file.
    """
    try:
        text = path.read_bytes().decode("ascii")
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give a {CSV_NAME}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a text file; give a {CSV_NAME}") from None
    head, *lines = text[: text.rfind("\n") + 1].splitlines() or [""]
    if head != ",".join(COLUMNS):
        raise InputError(f"{path}: the first line does not name the columns of telemetry; give a {CSV_NAME}")
    try:
        return _columns(_read_line(line) for line in lines)
    except ValueError as error:
        raise InputError(f"{path}: damaged ({error}); give a {CSV_NAME} as it was written") from None


def _read_line(line: str) -> Record:
    fields = line.split(",")
    return tuple(
        text if name in TEXTS else int(text) if name in WHOLE_NUMBERS else float(text)
        for name, text in zip(COLUMNS, fields, strict=True)
    )
