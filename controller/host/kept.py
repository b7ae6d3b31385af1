"""Data about devices that the host keeps between commands, in small files in the user's state directory.

A device knows only the hash of its library; the name of the scene that the library was solved from is kept here. A
library that was uploaded from elsewhere has no name.

Sweeps identify a device, so there may be no library yet that predicts its test pulses. The check then measures the
acceleration per ampere with a few single pulses, and the device judges its pulses by that measurement: this checks
the current, the sign, and that the response repeats. `record sweep` needs the same number for the same
configuration, by whose hash it is kept: two devices may have started equally often.

An encoder counts from where it starts, so the surface in a device file is that of one start of the device, which is
kept here too. A surface that somebody stated by hand may hold at every start, of a device that starts at a stop.
"""

import hashlib
import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from transopt.base.errors import InputError
from transopt.base.files import whole_file

SHOWN = 8  # hexadecimal digits


@dataclass(frozen=True)
class Kept:
    """A file of lines with a key and a value, one line per key.

    Attributes
    ----------
    name : name of the file. most : number of lines it keeps, the newest ones.
    """

    name: str
    most: int

    @property
    def _path(self) -> Path:
        base = os.environ.get("XDG_STATE_HOME")
        return (Path(base) if base else Path.home() / ".local" / "state") / "transopt" / self.name

    def _values(self) -> dict[str, str]:
        # A file that cannot be read counts as empty: libraries have no names, and no pulse was measured.
        with suppress(OSError, UnicodeDecodeError):
            lines = self._path.read_text(encoding="utf-8").splitlines()
            return {key: value for key, _, value in (line.partition(" ") for line in lines) if value}
        return {}

    def recall(self, key: str) -> str:
        """The value of a key; empty if there is none."""
        return self._values().get(key, "")

    def remember(self, key: str, value: str) -> None:
        """Store a value; silently without effect if the file cannot be written."""
        values = self._values()
        values.pop(key, None)
        lines = [*list(values.items())[1 - self.most :], (key, " ".join(value.split()))]
        with suppress(OSError, InputError):
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with whole_file(self._path) as file:
                file.write("".join(f"{key} {value}\n" for key, value in lines).encode())


LIBRARIES, PULSES, SURFACES = Kept("libraries", 1000), Kept("pulses", 200), Kept("surfaces", 200)


def library_in_words(library_sha256: bytes) -> str:
    """`wood_on_foam (3fa2b1c0)`; only the hash if the library has no name; `no library` for a hash of zeros."""
    if not any(library_sha256):
        return "no library"
    digest = library_sha256.hex()
    name = LIBRARIES.recall(digest)
    return f"{name} ({digest[:SHOWN]})" if name else f"library {digest[:SHOWN]}"


def remember_library(library_sha256: bytes, name: str) -> None:
    """Store the name of a library."""
    LIBRARIES.remember(library_sha256.hex(), name)


def measured_pulse(configuration_sha256: bytes) -> float | None:
    """Acceleration per ampere [m/s^2] by which this configuration judges pulses; None if not measured."""
    with suppress(ValueError):
        found = float(PULSES.recall(configuration_sha256.hex()))
        return found if 0 < found < float("inf") else None
    return None


def remember_pulse(configuration_sha256: bytes, acceleration_m_s2: float) -> None:
    """Store a measured pulse; if it cannot be written, `record sweep` demands the check again."""
    PULSES.remember(configuration_sha256.hex(), repr(acceleration_m_s2))


def _surface_in(device_file: Path, counts: float) -> str:
    # A key has no blanks, the name of a file may have.
    return hashlib.sha256(f"{device_file.resolve()}: {counts!r}".encode()).hexdigest()


def remember_surface(device_file: Path, counts: float, boot: int) -> None:
    """Store that the surface in a device file was measured at this start of the device."""
    SURFACES.remember(_surface_in(device_file, counts), f"{boot:08x}")


def surface_is_old(device_file: Path, counts: float, boot: int) -> bool:
    """Whether the surface in a device file was measured at another start of the device."""
    return SURFACES.recall(_surface_in(device_file, counts)) not in ("", f"{boot:08x}")
