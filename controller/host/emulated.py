"""The line to a board in an emulator, whose time advances only while the host waits for it.

Its name is `PORT,clock=PORT2`, two pseudo-terminals of the emulator. On the second one the host starts a turn of
`TURN_S` of the board's time by sending the number of bytes that it has sent before. The board reads those first, and
ends the turn by replying with the number of bytes that it has sent. So nothing depends on the speed of the emulator
or the load of the machine.
"""

import os
import select
import termios

from controller.host.connection import CLOCK, PortError, UnpluggedError

TURN_S = 5e-3  # equal to that in port/stm32f405/emulated.c
STANDSTILL_S, LATE_S = 30.0, 0.5  # longest duration of a turn; longest wait for its bytes
SAID_BYTES, MOST_BYTES = 2, 4096  # size of a count; most bytes sent before a turn
BLOCK_BYTES = 1 << 16


class EmulatedPort:
    """A `controller.host.connection.Connection`.

    Parameters
    ----------
    name : of both terminals.

    Raises
    ------
    PortError : one of them cannot be opened.
    """

    harmless = False

    def __init__(self, name: str) -> None:
        self.name, self._turns = name, 0
        self._leaving, self._open = b"", list[int]()
        try:
            for terminal in name.split(CLOCK, 1):
                self._open.append(os.open(terminal, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK))
                termios.tcflush(self._open[-1], termios.TCIFLUSH)  # discard bytes meant for a previous host
        except (OSError, termios.error) as error:
            self.close()
            raise PortError(f"{name}: {error}: give the terminals that the emulator has printed") from None

    def now_s(self) -> float:
        return TURN_S * self._turns

    def read(self, timeout_s: float) -> bytes:
        end_s = self.now_s() + timeout_s
        while True:
            port, clock = self._terminals()
            try:
                data = self._turn(port, clock)
            except OSError as error:
                raise self._gone(str(error)) from None
            if data or self.now_s() >= end_s:
                return data

    def write(self, data: bytes) -> None:
        """Queue the bytes; the board reads them in its next turns."""
        self._terminals()
        self._leaving += data

    def close(self) -> None:
        while self._open:
            os.close(self._open.pop())

    def _terminals(self) -> list[int]:
        if not self._open:
            raise self._gone("closed")
        return self._open

    def _turn(self, port: int, clock: int) -> bytes:
        """Give the board one turn; return the bytes that it sent.

        Raises
        ------
        OSError : the emulator is gone.
        """
        ready = self._leaving and select.select([], [port], [], 0)[1]
        size = os.write(port, self._leaving[:MOST_BYTES]) if ready else 0
        self._leaving = self._leaving[size:]
        os.write(clock, size.to_bytes(SAID_BYTES, "little"))
        said = _read(clock, SAID_BYTES, SAID_BYTES, STANDSTILL_S)
        if len(said) < SAID_BYTES:
            raise OSError("its clock stands still")
        self._turns += 1
        return _read(port, int.from_bytes(said, "little"), BLOCK_BYTES, LATE_S)

    def _gone(self, detail: str) -> UnpluggedError:
        return UnpluggedError(f"{self.name}: the emulator is gone ({detail}): start it again", detail)


def _read(terminal: int, wanted: int, most: int, within_s: float) -> bytes:
    """Read at least `wanted` bytes; fewer if the next ones do not come within `within_s`.

    Raises
    ------
    OSError : the terminal is gone.
    """
    data = b""
    while len(data) < wanted and select.select([terminal], [], [], within_s)[0]:
        came = os.read(terminal, most - len(data))
        if not came:
            raise OSError("it has ended")
        data += came
    return data
