"""Telemetry of a run, tick by tick, to CSV and NPZ that are whole at any moment.

The CSV grows by blocks of complete lines, each block one write; a reader drops what stands after the last line end.
The NPZ is replaced as a whole (written beside its place, renamed over it) each time the run has become a quarter
longer, as long as that takes less than a lease, and when the run ends.
"""

import os
import struct
from collections.abc import Iterable
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controller.protocol.codes import STATES
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
STORED_WHILE_RUNNING = 200_000  # records; writing the NPZ of as many takes a tenth of a lease
MOST_STORED = 2_000_000  # records in the NPZ, 200 s at 10 kHz; the CSV has them all
# As COLUMNS, the state by its number, without the events, which are few.
PACKED = struct.Struct("<qdddddBdBddd")
PACKED_TYPE = np.dtype([(name, kind) for name, kind in zip(COLUMNS[:-1], "qdddddBdBddd", strict=True)])


def _values(readings: Readings, output: Output, dt_s: float) -> tuple[int | float | str, ...]:
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


class Lines:
    """A text file that grows by whole lines, each append one write.

    Parameters
    ----------
    over : an older file of this name is written over; without it, that is an error.

    Raises
    ------
    InputError : it cannot be written.
    """

    def __init__(self, path: Path, head: str, *, over: bool) -> None:
        self._path = path
        try:
            self._file = os.open(
                path, os.O_WRONLY | os.O_CREAT | (os.O_TRUNC if over else os.O_EXCL) | os.O_APPEND, 0o644
            )
        except OSError as error:
            raise self._refusal(error) from None
        self.append(head + "\n")

    def append(self, text: str) -> None:
        block = text.encode("ascii")
        try:
            while block:
                block = block[os.write(self._file, block) :]
        except OSError as error:
            raise self._refusal(error) from None

    def close(self) -> None:
        os.close(self._file)

    def _refusal(self, error: OSError) -> InputError:
        return InputError(f"{self._path}: cannot be written ({error.strerror}); choose another folder")


class Telemetry:
    """Writes one run's records into a folder; use it as a context manager.

    Parameters
    ----------
    folder : must exist.
    block_ticks : records per write.
    over : an older run in the folder is written over; without it, that is an error.

    Raises
    ------
    InputError : the folder cannot be written.
    """

    def __init__(self, folder: Path, dt_s: float, *, block_ticks: int = BLOCK_TICKS, over: bool = True) -> None:
        self._folder, self._dt_s, self._block_ticks = folder, dt_s, block_ticks
        self._csv = Lines(folder / CSV_NAME, ",".join(COLUMNS), over=over)
        # An NPZ of an earlier run must not be taken for this one's.
        (folder / NPZ_NAME).unlink(missing_ok=True)
        self._lines: list[str] = []
        self._packed = bytearray()
        self._events: dict[int, str] = {}  # by number of the record
        self._records = self._stored = 0  # in the memory and in the NPZ

    def record(self, readings: Readings, output: Output) -> None:
        """One tick."""
        *values, events = _values(readings, output, self._dt_s)
        # repr of a float is the shortest text that reads back as the same number.
        words = [repr(value) if isinstance(value, float) else str(value) for value in values]
        self._lines.append(",".join([*words, str(events)]) + "\n")
        if self._records < MOST_STORED:
            if events:
                self._events[self._records] = str(events)
            values[COLUMNS.index("state")] = STATES.index(output.state)
            self._packed += PACKED.pack(*values)
            self._records += 1
        if len(self._lines) >= self._block_ticks:
            self.flush()

    def flush(self) -> None:
        """Bring the CSV up to date, and the NPZ if it lags far behind."""
        lines, self._lines = self._lines, []
        self._csv.append("".join(lines))
        if GROWTH * self._stored <= self._records <= STORED_WHILE_RUNNING:
            self._store()

    def close(self) -> None:
        """Both files complete."""
        try:
            self.flush()
            self._store()
        finally:
            self._csv.close()

    def __enter__(self) -> "Telemetry":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _store(self) -> None:
        table = np.frombuffer(bytes(self._packed), dtype=PACKED_TYPE)
        columns: dict[str, NDArray[Any]] = {name: table[name] for name in PACKED_TYPE.names or ()}
        columns["emergency_stop"] = table["emergency_stop"].astype(np.int64)
        columns["state"] = np.array([state.value for state in STATES])[table["state"]]
        longest = max(map(len, self._events.values()), default=1)
        events = np.zeros(self._records, dtype=f"<U{longest}")
        for place, text in self._events.items():
            events[place] = text
        with whole_file(self._folder / NPZ_NAME) as file:
            np.savez(file, **columns, events=events)  # type: ignore[arg-type]
        self._stored = self._records


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


def _columns(records: Iterable[tuple[int | float | str, ...]]) -> dict[str, NDArray[Any]]:
    by_column = list(zip(*records, strict=True)) or [()] * len(COLUMNS)
    kinds: dict[str, type] = {**dict.fromkeys(WHOLE_NUMBERS, np.int64), **dict.fromkeys(TEXTS, np.str_)}
    return {
        name: np.array(values, dtype=kinds.get(name, np.float64))
        for name, values in zip(COLUMNS, by_column, strict=True)
    }


def _read_line(line: str) -> tuple[int | float | str, ...]:
    fields = line.split(",")
    return tuple(
        text if name in TEXTS else int(text) if name in WHOLE_NUMBERS else float(text)
        for name, text in zip(COLUMNS, fields, strict=True)
    )
