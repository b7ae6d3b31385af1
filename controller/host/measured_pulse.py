"""What a test pulse does to a device that no model describes yet: measured once per start, then expected.

Sweeps identify a device, so there may be no library that predicts its pulses. The check then measures the
acceleration per ampere with a few single pulses, and what it found is the prediction that the device judges its own
pulses by: so the current is checked, the sign, and that the pulses come back alike. `record sweep` needs the same
number for the same configuration; it is kept in a small file of the user's, one line per start of a device.
"""

import os
from contextlib import suppress
from pathlib import Path

from transopt.base.errors import InputError
from transopt.base.files import whole_file

KEPT = 200  # lines


def _path() -> Path:
    base = os.environ.get("XDG_STATE_HOME")
    return (Path(base) if base else Path.home() / ".local" / "state") / "transopt" / "pulses"


def _lines() -> list[str]:
    # A file that cannot be read means that nothing was measured, the careful side.
    with suppress(OSError, UnicodeDecodeError):
        return _path().read_text(encoding="ascii").splitlines()
    return []


def recall(boot: int) -> float | None:
    """Acceleration per ampere [m/s^2] as measured since this start; None where it was not."""
    for line in reversed(_lines()):
        key, _, value = line.partition(" ")
        if key == f"{boot:08x}":
            with suppress(ValueError):
                found = float(value)
                return found if 0 < found < float("inf") else None
    return None


def remember(boot: int, acceleration_m_s2: float) -> None:
    """Keep a measured pulse; if nothing can be written, `record sweep` asks for the check again."""
    lines = [line for line in _lines() if not line.startswith(f"{boot:08x} ")][1 - KEPT :]
    with suppress(OSError, InputError):
        _path().parent.mkdir(parents=True, exist_ok=True)
        with whole_file(_path()) as file:
            file.write("".join(f"{line}\n" for line in [*lines, f"{boot:08x} {acceleration_m_s2!r}"]).encode("ascii"))
