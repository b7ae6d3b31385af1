"""The rows of a study on disk: whole lines are appended, a torn last one is cut, a finished file is sorted.

A folder holds `study.json`, which says what is studied and with which versions, and `rows.csv`, one row per solve.
"""

import contextlib
import csv
import io
import json
import os
import platform
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, fields
from importlib import metadata
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self

import numpy as np

from transopt.base.errors import InputError
from transopt.base.files import ctrl_c_waits, whole_file, without_nan
from transopt.design.sweep import REFUSED, Outcome
from transopt.problem.answer import Status
from transopt.study.axes import label

try:
    import fcntl
except ImportError:  # Windows: nobody is kept from writing into a folder twice at a time
    fcntl = None  # type: ignore[assignment]

OUTCOME = [field.name for field in fields(Outcome) if field.name != "index"]
SCHEMA = 1
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


def versions() -> dict[str, str]:
    """Of everything that may move the last digits of a row."""
    found = {name: metadata.version(name) for name in ("transopt", "casadi", "numpy", "scipy")}
    return {**found, "python": platform.python_version()}


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return "" if np.isnan(value) else repr(value)
    return label(value)


def line(cells: Sequence[str]) -> bytes:
    """One line of a CSV file; a cell never holds an end of line."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow([" ".join(cell.split()) for cell in cells])
    return text.getvalue().encode()


def row_of(outcome: Outcome, point: int, labels: Mapping[str, str]) -> Row:
    """A row: number, point, the varied values, and what came out."""
    cells = {name: _cell(value) for name, value in asdict(outcome).items() if name != "index"}
    return {"index": str(outcome.index), "point": str(point), **labels, **cells}


def number(row: Row, column: str) -> float:
    """A cell as a number, NaN where it is empty."""
    return float(row[column]) if row[column] else float("nan")


def exit_code(rows: Sequence[Row]) -> int:
    """0 if every row is certified or a refusal, and one at least is certified; else 1."""
    found = {row["status"] for row in rows}
    return 0 if OPTIMAL in found and found <= {OPTIMAL, *REFUSALS} else 1


def _first_difference(old: Any, new: Any, path: str = "") -> str:
    """The first place, in the words of study.json, where two definitions differ; empty if none."""
    if isinstance(old, dict) and isinstance(new, dict):
        for name in [*new, *(name for name in old if name not in new)]:
            found = _first_difference(old.get(name), new.get(name), f"{path}.{name}" if path else name)
            if found:
                return found
        return ""
    if old == new:
        return ""
    shown = [text if len(text := json.dumps(side)) <= 60 else f"{text[:57]}..." for side in (old, new)]
    return f"{path} {shown[0]} there, {shown[1]} now"


class Rows:
    """The rows of one study; a context manager that keeps other runs out of its folder.

    Attributes
    ----------
    done : number of rows there are. cut : what was taken off a torn end, empty if nothing was.
    """

    def __init__(self, folder: Path, definition: dict[str, Any], keys: Sequence[str], most: int) -> None:
        """Parameters
        ----------
        definition : JSON values; a folder that holds another one is refused. most : number of rows to come.

        Raises
        ------
        InputError : another study's folder, or one that cannot be written; rows.csv is damaged.
        """
        self.folder, self.path = folder, folder / "rows.csv"
        self.columns = ["index", "point", *keys, *OUTCOME]
        self._there = np.zeros(most, dtype=bool)
        self.done, self.cut = 0, ""
        content = {"schema": SCHEMA, "versions": versions(), **definition}
        self._definition: dict[str, Any] = json.loads(json.dumps(without_nan(content)))

    def __enter__(self) -> Self:
        with contextlib.ExitStack() as opened:
            try:
                self.folder.mkdir(parents=True, exist_ok=True)
                self._lock = opened.enter_context(self._manifest())
                self._keep_others_out()
                self._check(self._lock.read())
                self._file = self.path.open("ab")
                opened.callback(self._close)
                self._resume()
            except OSError as error:
                raise InputError(
                    f"--out {self.folder}: cannot be written ({error.strerror}); choose another folder"
                ) from None
            self._opened = opened.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._opened.close()

    def _close(self) -> None:
        self._file.close()

    def _manifest(self) -> BinaryIO:
        """study.json, written if there is none."""
        path = self.folder / "study.json"
        if not path.exists():
            if self.path.exists():
                raise InputError(f"--out {self.folder}: rows.csv without study.json: choose another folder")
            with whole_file(path) as file:
                file.write(json.dumps(self._definition, indent=1).encode())
        return path.open("rb")

    def _keep_others_out(self) -> None:
        if fcntl is None:
            return
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(f"--out {self.folder}: another run is writing there: wait for it or stop it") from None

    def _check(self, stored: bytes) -> None:
        try:
            old = json.loads(stored)
        except ValueError:
            raise InputError(f"{self.folder / 'study.json'}: damaged: choose another --out folder") from None
        difference = _first_difference(old, self._definition)
        if difference:
            raise InputError(f"--out {self.folder}: holds another study: {difference}; choose another folder")

    def _resume(self) -> None:
        """Cut a torn end, and learn which rows there are."""
        header, size = line(self.columns), self.path.stat().st_size
        whole = 0
        with self.path.open("rb") as file:
            for raw in file:
                if not raw.endswith(b"\n"):
                    break
                if whole == 0:
                    if raw != header:
                        raise InputError(f"{self.path}: other columns than this study's: choose another --out folder")
                else:
                    self._note(raw)
                whole += len(raw)
        if whole < size:
            self._file.truncate(whole)
            self.cut = f"{self.path}: {size - whole} bytes of a torn last line cut"
        if whole == 0:
            self._append(header)

    def _note(self, raw: bytes) -> None:
        try:
            cells = next(csv.reader([raw.decode()]))
            index = int(cells[0])
        except (ValueError, UnicodeDecodeError, csv.Error):
            cells, index = [], -1
        if len(cells) != len(self.columns) or not 0 <= index < self._there.size or self._there[index]:
            raise InputError(f"{self.path}: a line in the middle is damaged: choose another --out folder")
        self._there[index] = True
        self.done += 1

    def _append(self, text: bytes) -> None:
        with ctrl_c_waits():
            self._file.write(text)
            self._file.flush()
            os.fsync(self._file.fileno())

    def has(self, index: int) -> bool:
        return bool(self._there[index])

    def add(self, rows: Sequence[Row]) -> int:
        """Append those that are not there yet, in one piece; how many that were."""
        new = [row for row in rows if not self._there[int(row["index"])]]
        self._append(b"".join(line([row[column] for column in self.columns]) for row in new))
        for row in new:
            self._there[int(row["index"])] = True
        self.done += len(new)
        return len(new)

    def read(self) -> Iterator[Row]:
        """Every row, in the order of the file."""
        with self.path.open(newline="", encoding="utf-8") as file:
            yield from csv.DictReader(file)

    def sort(self) -> list[Row]:
        """Put the file in order, by number, and return its rows."""
        found = sorted(self.read(), key=lambda row: int(row["index"]))
        with whole_file(self.path) as file:
            file.write(line(self.columns))
            for row in found:
                file.write(line([row[column] for column in self.columns]))
        self._file.close()
        self._file = self.path.open("ab")
        return found
