"""Write the telemetry of a run, tick by tick, to CSV and NPZ files that are complete at any moment.

The CSV grows by blocks of complete lines, each in one write; a reader drops anything after the last line end. The NPZ
is replaced atomically (written beside its place, then renamed) each time the run has grown by a quarter, as long as
that takes less than a lease, and when the run ends.
"""

import os
from pathlib import Path

import numpy as np

from controller.protocol.codes import STATES
from controller.protocol.messages import STOP_PRESSED, Record
from transopt.base.errors import InputError
from transopt.base.files import whole_file
from transopt.base.signals import AnyArray

CSV_NAME, NPZ_NAME = "telemetry.csv", "telemetry.npz"
# Counts are float64, since a broken encoder gives NaN. Events are few and are kept separately.
KINDS = {
    "tick": "i8",
    "time_s": "f8",
    "encoder_counts": "f8",
    "grip_N": "f8",
    "measured_current_A": "f8",
    "measured_acceleration_m_s2": "f8",
    "emergency_stop": "i8",
    "command_A": "f8",
    "state": "S7",
    "transient_A": "f8",
    "feedback_A": "f8",
    "winding_C": "f8",
}
PACKED = np.dtype(list(KINDS.items()))
COLUMNS = (*KINDS, "events")
BLOCK_TICKS = 1000
GROWTH = 1.25
STORED_WHILE_RUNNING = 200_000  # records; writing the NPZ of as many takes a tenth of a lease
MOST_STORED = 2_000_000  # records in the NPZ, 200 s at 10 kHz; the CSV has them all


class Lines:
    """A text file that grows by whole lines; what a full disk cuts off is taken back.

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
        try:
            self.append(head + "\n")
        except InputError:  # a file without a head would be taken for a recording
            self.close()
            path.unlink()
            raise

    def append(self, text: str) -> None:
        block, whole = text.encode("ascii"), os.fstat(self._file).st_size
        try:
            while block:
                block = block[os.write(self._file, block) :]
        except OSError as error:
            os.ftruncate(self._file, whole)
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
        self._rows: list[tuple[int | float | str, ...]] = []  # rows not yet in the CSV
        self._texts: list[str] = []  # their events
        self._blocks: list[AnyArray] = []
        self._events: dict[int, str] = {}  # number of a record -> its events
        self._records = self._stored = 0  # numbers of records in the blocks and in the NPZ

    def record(self, tick: int, record: Record, events: str = "") -> None:
        """One tick; events by their names, separated by semicolons."""
        r = record
        measured = r.encoder_counts, r.grip_N, r.measured_current_A, r.acceleration_m_s2, r.flags & STOP_PRESSED
        answer = r.command_A, STATES[r.state].value, r.transient_A, r.feedback_A, r.winding_C
        self._rows.append((tick, tick * self._dt_s, *measured, *answer))
        self._texts.append(events)
        if len(self._rows) >= self._block_ticks:
            self.flush()

    def flush(self) -> None:
        """Bring the CSV up to date, and the NPZ if it lags far behind."""
        rows, texts, self._rows, self._texts = self._rows, self._texts, [], []
        # The text of a number is the shortest that reads back as the same one.
        self._csv.append(
            "".join(",".join([*map(str, row), text]) + "\n" for row, text in zip(rows, texts, strict=True))
        )
        kept = rows[: MOST_STORED - self._records]
        self._events |= {self._records + j: text for j, text in enumerate(texts[: len(kept)]) if text}
        self._blocks.append(np.array(kept, dtype=PACKED))
        self._records += len(kept)
        if GROWTH * self._stored <= self._records <= STORED_WHILE_RUNNING:
            self._store()

    def close(self) -> None:
        """Complete both files."""
        try:
            self.flush()
            self._store()
        finally:
            self._csv.close()

    def __enter__(self) -> "Telemetry":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _store(self) -> None:
        self._blocks = [np.concatenate(self._blocks)]
        columns = {name: self._blocks[0][name] for name in KINDS}
        columns["state"] = columns["state"].astype(np.str_)
        longest = max(map(len, self._events.values()), default=1)
        columns["events"] = np.zeros(self._records, dtype=f"<U{longest}")
        for place, text in self._events.items():
            columns["events"][place] = text
        with whole_file(self._folder / NPZ_NAME) as file:
            np.savez(file, **columns)  # type: ignore[arg-type]
        self._stored = self._records
