"""Store of a study's rows: one SQLite file, from which a study that was stopped or killed goes on.

SQLite gives what a long run needs on every system: a row is in the file whole or not at all, whenever the process is
killed; a second process that opens the file finds it locked; and rows come out in the order of their numbers, in
whatever order the workers finished them. Rows go through SQLite's write-ahead log, which the file takes in when it is
closed or, after a kill, opened again: waiting for the disk after every row would take a sixth of a study's time. A
power cut can cost the last rows, never the file.
"""

import json
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from transopt.base.errors import InputError
from transopt.base.files import ctrl_c_waits, without_nan
from transopt.base.machine import versions
from transopt.base.writing import csv_text, write_text
from transopt.study.rows import COLUMNS, Row

SCHEMA = 2
LIBRARIES = ("transopt", "casadi", "numpy", "scipy")  # whose versions may move the last digits of a row


def _first_difference(old: Any, new: Any, path: str = "") -> str:
    """The first key at which two definitions differ, with both values; empty if they are the same."""
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


def _named(columns: Sequence[str]) -> str:
    """Columns as SQL names them: quoted, because a key has a dot in it."""
    return ", ".join(f'"{column}"' for column in columns)


class Store:
    """The rows of one study in `study.sqlite` of a folder, and in `rows.csv` beside it once the store is closed.

    A context manager: while it is open, no other process can open the same file.

    Attributes
    ----------
    path : the SQLite file.
    columns : of a row: its number, that of its point, the varied keys, the outcome.
    done : how many rows there are.
    """

    def __init__(self, folder: Path, definition: dict[str, Any], keys: Sequence[str], most: int) -> None:
        """Say what is to be kept; the file is opened by `with`.

        Parameters
        ----------
        definition : JSON values that say what is studied; the versions of the libraries are added to it.
        keys : the varied keys.
        most : rows that the study can come to.
        """
        self.folder, self.path = folder, folder / "study.sqlite"
        self.columns = ["index", "point", *keys, *COLUMNS]
        self._there = np.zeros(most, dtype=bool)
        content = {"schema": SCHEMA, "versions": versions(*LIBRARIES), "columns": list(COLUMNS), **definition}
        self._definition: dict[str, Any] = json.loads(json.dumps(without_nan(content)))

    def __enter__(self) -> Self:
        """Open the file, or make it.

        Raises
        ------
        InputError : it holds another study, another process has it open, or it cannot be read or written.
        """
        with self._refusing():
            self.folder.mkdir(parents=True, exist_ok=True)
            if not self.path.exists() and (self.folder / "rows.csv").exists():
                raise InputError(f"--out {self.folder}: rows.csv without {self.path.name}; choose another folder")
            self._file = sqlite3.connect(self.path, timeout=0.0)
            try:
                self._open()
            except BaseException:
                self._file.close()
                raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Write rows.csv, however the block ended, and let others in."""
        try:
            # Straight from the file: a study that is stopped has to end soon, however many rows it has.
            with self._refusing():
                text = csv_text(self.columns, self._cells(0, len(self._there)))
            write_text(text, self.folder / "rows.csv")
        finally:
            self._file.close()

    def _open(self) -> None:
        # The lock that the first transaction takes is kept until the file is closed.
        self._file.execute("PRAGMA locking_mode = EXCLUSIVE")
        self._file.execute("PRAGMA journal_mode = WAL")
        self._file.execute("PRAGMA synchronous = NORMAL")
        self._file.execute("BEGIN EXCLUSIVE")
        with self._file:
            self._file.execute("CREATE TABLE IF NOT EXISTS study (definition TEXT NOT NULL)")
            found = self._file.execute("SELECT definition FROM study").fetchone()
            if found is None:
                self._file.execute("INSERT INTO study VALUES (?)", [json.dumps(self._definition)])
            elif difference := _first_difference(json.loads(found[0]), self._definition):
                raise InputError(f"--out {self.folder}: holds another study: {difference}; choose another folder")
            names = _named(self.columns[1:])
            self._file.execute(f'CREATE TABLE IF NOT EXISTS rows ("index" INTEGER PRIMARY KEY, {names})')
        numbers = [number for (number,) in self._file.execute('SELECT "index" FROM rows')]
        self._there[numbers] = True

    @contextmanager
    def _refusing(self) -> Iterator[None]:
        """What goes wrong with the file, in one line."""
        another = f"--out {self.folder}: cannot be written ({{}}); choose another folder"
        try:
            yield
        except InputError:  # a ValueError too: it says what is wrong already
            raise
        except OSError as error:
            raise InputError(another.format(error.strerror)) from None
        except sqlite3.OperationalError as error:
            if error.sqlite_errorcode == sqlite3.SQLITE_BUSY:
                raise InputError(
                    f"--out {self.folder}: another run is writing there: wait for it or stop it"
                ) from None
            raise InputError(another.format(error)) from None
        except (sqlite3.DatabaseError, ValueError, IndexError) as error:
            raise InputError(f"{self.path}: damaged ({error}); choose another --out folder") from None

    @property
    def done(self) -> int:
        return int(np.count_nonzero(self._there))

    def has(self, index: int) -> bool:
        """Whether the row of that number is there."""
        return bool(self._there[index])

    def add(self, rows: Sequence[Row]) -> int:
        """Keep those rows that are not there yet, all or none; how many that were.

        Raises
        ------
        InputError : the file cannot be written.
        """
        before = self.done
        marks = ", ".join("?" * len(self.columns))
        with self._refusing(), ctrl_c_waits():
            with self._file:
                cells = [[row[column] for column in self.columns] for row in rows]
                self._file.executemany(f"INSERT OR IGNORE INTO rows VALUES ({marks})", cells)
            self._there[[int(row["index"]) for row in rows]] = True
        return self.done - before

    def read(self, first: int = 0, count: int | None = None) -> list[Row]:
        """The rows of the numbers from `first` on, or `count` of them, in the order of their numbers."""
        after = len(self._there) if count is None else first + count
        with self._refusing():
            return [dict(zip(self.columns, map(str, cells), strict=True)) for cells in self._cells(first, after)]

    def _cells(self, first: int, after: int) -> sqlite3.Cursor:
        wanted = f'SELECT {_named(self.columns)} FROM rows WHERE "index" >= ? AND "index" < ? ORDER BY "index"'
        return self._file.execute(wanted, [first, after])
