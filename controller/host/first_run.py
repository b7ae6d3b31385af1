"""Which devices have played a configuration since their start: the first run is a quiet one.

One line per device start and configuration in a small file of the user's; it holds nothing else. The key is the boot
number, so that a device that has been off, and may have been rewired, begins quietly again.
"""

import os
from contextlib import suppress
from pathlib import Path

from controller.host.driver import Device
from transopt.base.errors import InputError
from transopt.base.files import whole_file

FIRST_GAIN = 0.1
KEPT = 200  # lines


def _path() -> Path:
    base = os.environ.get("XDG_STATE_HOME")
    return (Path(base) if base else Path.home() / ".local" / "state") / "transopt" / "played"


def _key(boot: int, configuration_sha256: bytes) -> str:
    return f"{boot:08x} {configuration_sha256.hex()}"


def _lines() -> list[str]:
    # A file that cannot be read means a first run, the careful side.
    with suppress(OSError, UnicodeDecodeError):
        return _path().read_text(encoding="ascii").splitlines()
    return []


def gain_to_play_at(device: Device, configuration_sha256: bytes, gain: float | None = None) -> float:
    """The gain that was asked for; without one 0.1 on a device's first run, then 1.

    A device that can do no harm has nothing wired wrong and plays in full.
    """
    if device.harmless:
        return 1.0 if gain is None else gain
    return default_gain(device.hello.boot, configuration_sha256) if gain is None else gain


def default_gain(boot: int, configuration_sha256: bytes) -> float:
    """0.1 until a tap has been played without a fault since the device's start, then 1."""
    return 1.0 if _key(boot, configuration_sha256) in _lines() else FIRST_GAIN


def remember(boot: int, configuration_sha256: bytes) -> None:
    """A tap has been played without a fault. Where nothing can be written the next run is a first one again."""
    key = _key(boot, configuration_sha256)
    lines = [line for line in _lines() if line != key][-KEPT:]
    with suppress(OSError, InputError):
        _path().parent.mkdir(parents=True, exist_ok=True)
        with whole_file(_path()) as file:
            file.write("".join(f"{line}\n" for line in [*lines, key]).encode("ascii"))
