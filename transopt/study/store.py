"""Store of a study's rows: one SQLite file, from which a stopped or killed study resumes.

SQLite gives what a long run needs on every system: a row is in the file completely or not at all, whenever the
process is killed; a second process finds the file locked; and rows are read in the order of their indices, in
whatever order they were written. Rows pass through SQLite's write-ahead log, which is merged when the file is closed
or, after a kill, opened again, because syncing the disk after every row would take a sixth of a study's time. A power
cut can lose the last rows, never the file.
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
LIBRARIES = ("transopt", "casadi", "numpy", "scipy")  # their versions may change the last digits of a row


def _first_difference(old: Any, new: Any, path: str = "") -> str:
    """The first key at which two definitions differ, with both values; empty if they are equal."""
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
    """Column names in SQL, quoted because keys contain dots."""
    return ", ".join(f'"{column}"' for column in columns)


class Store:
    """The rows of one study in `study.sqlite` of a folder, and in `rows.csv` beside it once the store is closed.

    It is a context manager; while it is open, no other process can open the file.

    Attributes
    ----------
    path : the SQLite file.
    columns : columns of a row: its index, the index of its point, the varied keys, the outcome.
    done : number of rows stored.
    """

    def __init__(self, folder: Path, definition: dict[str, Any], keys: Sequence[str], most: int) -> None:
        """Define the content; `with` opens the file.

        Parameters
        ----------
        definition : JSON values that define the study; the versions of the libraries are added.
        keys : the varied keys.
        most : largest possible number of rows.
        """
        self.folder, self.path = folder, folder / "study.sqlite"
        self.columns = ["index", "point", *keys, *COLUMNS]
        self._there = np.zeros(most, dtype=bool)
        content = {"schema": SCHEMA, "versions": versions(*LIBRARIES), "columns": list(COLUMNS), **definition}
        self._definition: dict[str, Any] = json.loads(json.dumps(without_nan(content)))

    def __enter__(self) -> Self:
        """Open or create the file.

        Raises
        ------
        InputError : the file holds another study, is open in another process, or cannot be read or written.
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
        """Write rows.csv, however the block ended, and release the file."""
        try:
            # Streamed from the file, so that a stopped study ends soon even with many rows.
            with self._refusing():
                text = csv_text(self.columns, self._cells(0, len(self._there)))
            write_text(text, self.folder / "rows.csv")
        finally:
            self._file.close()

    def _open(self) -> None:
        # The first transaction's lock is held until the file is closed.
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
        """Turn errors of the file into an InputError of one line."""
        another = f"--out {self.folder}: cannot be written ({{}}); choose another folder"
        try:
            yield
        except InputError:  # also a ValueError, but it says already what is wrong
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
        """Whether the row with this index is stored."""
        return bool(self._there[index])

    def add(self, rows: Sequence[Row]) -> int:
        """Store the rows that are not stored yet, all or none; returns their number.

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
        """The rows with indices from `first` on, or `count` of them, ordered by index."""
        after = len(self._there) if count is None else first + count
        with self._refusing():
            return [dict(zip(self.columns, map(str, cells), strict=True)) for cells in self._cells(first, after)]

    def _cells(self, first: int, after: int) -> sqlite3.Cursor:
        wanted = f'SELECT {_named(self.columns)} FROM rows WHERE "index" >= ? AND "index" < ? ORDER BY "index"'
        return self._file.execute(wanted, [first, after])
