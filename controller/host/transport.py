"""A serial port as a stream of bytes: the only file that uses pyserial.

Names are those of `serial.serial_for_url`: a device (`/dev/ttyACM0`, `COM3`, a pseudo-terminal), `loop://`,
`socket://HOST:PORT`; the baud rate may follow a device, as in `/dev/ttyUSB0@4000000`. A separate thread reads into a
bounded queue, since the driver's buffer loses what is not fetched in time. Errors of pyserial and of the system,
silent ones included, become `PortError` or `UnpluggedError` with a message of one line.

Thread-safety: `read` by one thread and `write` by one (the same or another); `close` by any, any number of times.
"""

import contextlib
import errno
import os
import queue
import re
import select
import threading
import time
from dataclasses import dataclass
from typing import Any

import serial
from serial.tools import list_ports

from controller.host.connection import PortError, UnpluggedError

BAUD = 115_200  # matters for a real UART only, not over USB
WINDOWS = re.compile(r"^(\\\\\.\\)?COM\d+$", re.IGNORECASE)
MOST_BAUD = 12_000_000
POLL_S = 0.05  # a blocked read returns after this, to see whether the port is to be closed
WRITE_TIMEOUT_S = 1.0
WRITE_BYTES = 1024  # bytes per write; the slowest line needs a tenth of the timeout for them
CLOSE_S = 1.0
BLOCK_BYTES = 4096
QUEUE_BLOCKS = 1024


@dataclass(frozen=True)
class Listed:
    """A serial port as the system lists it; vendor : vendor id of a USB device, else None."""

    name: str
    description: str
    vendor: int | None = None


def listed_ports() -> list[Listed]:
    """The serial ports of this machine, sorted by name."""
    found = [
        Listed(port.device, (port.description or "").removeprefix("n/a"), port.vid) for port in list_ports.comports()
    ]
    return sorted(found, key=lambda port: port.name)


def without_rate(name: str) -> tuple[str, int]:
    """Name of a port and its baud rate, from `NAME@RATE`.

    Raises
    ------
    PortError : the rate is not a number in range.
    """
    port, at, rate = name.rpartition("@")
    if not at or "://" in name:
        return name, BAUD
    if not rate.isdecimal() or not 0 < int(rate) <= MOST_BAUD:
        raise PortError(f"{name}: behind @ stands the rate in baud, up to {MOST_BAUD}, like {port}@4000000")
    return port, int(rate)


def _ports_in_words() -> str:
    names = [port.name for port in listed_ports()]
    return f"there are {', '.join(names)}" if names else "there is no serial port at all: plug the device in"


def _refusal(name: str, error: Exception) -> PortError:
    """The error of a port that does not open, by the system's errno, which pyserial often gives only in its text."""
    number = getattr(error, "errno", None)
    cause = error.__context__
    if number is None and isinstance(cause, OSError):
        number = cause.errno
    text = str(error)
    if WINDOWS.match(name) and "PermissionError" in text:
        return PortError(f"{name}: busy: another program has it open; close that one")
    if number in (errno.EACCES, errno.EPERM) or isinstance(error, PermissionError) or "Permission" in text:
        group = "add yourself to the group dialout (sudo usermod -aG dialout $USER) and log in again"
        return PortError(f"{name}: no permission: {group}")
    if number in (errno.EBUSY, errno.EAGAIN) or "exclusively lock" in text or "busy" in text.lower():
        return PortError(f"{name}: busy: another program has it open; close that one")
    if name.startswith("socket:"):
        why = os.strerror(number) if number else text
        return PortError(f"{name}: nobody answers there ({why}): start transopt-device")
    if number in (errno.ENOENT, errno.ENODEV, errno.ENXIO) or "could not open port" in text:
        return PortError(f"{name}: no such port; {_ports_in_words()}")
    return PortError(f"{name}: cannot be opened as a serial port ({text}); {_ports_in_words()}")


class Transport:
    """An open port, a `Connection`.

    Parameters
    ----------
    name : name of the port for `serial_for_url`, with an optional baud rate.

    Raises
    ------
    PortError : there is no such port, permission is denied, the port is busy, or it is no serial port.
    """

    harmless = False

    def __init__(self, name: str) -> None:
        self.name = name
        self._closing, self._failed = threading.Event(), threading.Event()
        self._detail = ""
        self._queue: queue.Queue[bytes] = queue.Queue(QUEUE_BLOCKS)
        # URL ports do not know this argument.
        exclusive: dict[str, Any] = {} if "://" in name else {"exclusive": True}
        path, baud = without_rate(name)
        try:
            self._port = serial.serial_for_url(path, baud, timeout=POLL_S, write_timeout=WRITE_TIMEOUT_S, **exclusive)
        except (OSError, ValueError) as error:  # SerialException is an OSError
            raise _refusal(path, error) from None
        # On a file descriptor the reader waits by select and reads without blocking, also from a socket, whose
        # `in_waiting` is not a count. Ports without one (loop://, Windows) block for one byte.
        self._descriptor = self._descriptor_of_port()
        self._reader = threading.Thread(target=self._read_on, name=f"reader of {name}", daemon=True)
        self._reader.start()

    def _descriptor_of_port(self) -> int | None:
        try:
            descriptor = int(self._port.fileno())
        except (AttributeError, OSError):  # io.UnsupportedOperation is an OSError
            return None
        self._port.timeout = 0
        return descriptor

    def now_s(self) -> float:
        return time.monotonic()

    def read(self, timeout_s: float) -> bytes:
        try:
            blocks = [self._queue.get(timeout=max(timeout_s, 0.0)) if timeout_s > 0 else self._queue.get_nowait()]
        except queue.Empty:
            blocks = []
        with contextlib.suppress(queue.Empty):
            while True:
                blocks.append(self._queue.get_nowait())
        data = b"".join(blocks)
        if not data:
            self._check()
        return data

    def write(self, data: bytes) -> None:
        self._check()
        if not data:
            return
        try:
            for at in range(0, len(data), WRITE_BYTES):
                self._port.write(data[at : at + WRITE_BYTES])
        except serial.SerialTimeoutException:
            self._fail("it has taken no data for a second")
        # A port that is gone, or that another thread is closing, raises any of these.
        except (OSError, TypeError, ValueError, AttributeError) as error:
            self._fail(str(error))
        self._check()

    def close(self) -> None:
        self._closing.set()
        with contextlib.suppress(Exception):
            self._port.cancel_read()
        if threading.current_thread() is not self._reader:
            self._reader.join(CLOSE_S)
        # A port that is gone raises termios.error here, which is not an OSError.
        with contextlib.suppress(Exception):
            self._port.close()

    def __enter__(self) -> "Transport":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _check(self) -> None:
        if self._closing.is_set():
            raise UnpluggedError(f"{self.name}: closed")
        if self._failed.is_set() and self._queue.empty():
            message = f"{self.name}: the connection is gone ({self._detail}): plug the device in again"
            raise UnpluggedError(message, self._detail)

    def _fail(self, detail: str) -> None:
        if not self._failed.is_set():
            self._detail = detail
            self._failed.set()

    def _read_on(self) -> None:
        """The reader's thread: reads until closed, and records why it ended."""
        try:
            while not self._closing.is_set():
                if self._descriptor is None:
                    data = self._port.read(1)
                    data += self._port.read(min(self._port.in_waiting, BLOCK_BYTES)) if data else b""
                elif select.select([self._descriptor], [], [], POLL_S)[0]:
                    data = self._port.read(BLOCK_BYTES)
                else:
                    continue
                if data:
                    self._put(data)
        except Exception as error:  # termios.error too, and TypeError of a port closed meanwhile
            self._fail(str(error) or type(error).__name__)
        else:
            self._fail("closed")
        with contextlib.suppress(queue.Full):
            self._queue.put_nowait(b"")  # wakes a waiting `read`

    def _put(self, data: bytes) -> None:
        while not self._closing.is_set():
            with contextlib.suppress(queue.Full):
                self._queue.put(data, timeout=POLL_S)
                return
