"""The line to a board in an emulator, whose time passes only while the host waits for it.

A port of the name `PORT,clock=PORT2` is one: two pseudo-terminals of the emulator. On the second the host gives the
board a turn, `TURN_S` of its time, and says how many bytes it has sent before. The board takes those first, and ends
the turn by saying how many it has sent in it. So nothing depends on how fast the emulator is, or on what else the
machine has to do.
"""

import os
import select
import termios

from controller.host.connection import CLOCK, PortError, UnpluggedError

TURN_S = 5e-3  # as port/stm32f405/emulated.c has it
STANDSTILL_S, LATE_S = 30.0, 0.5  # in which a turn has to be through; in which its bytes come, or were nobody's
SAID_BYTES, MOST_BYTES = 2, 4096  # of a count, and of what is sent before a turn
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
                termios.tcflush(self._open[-1], termios.TCIFLUSH)  # what came for another host
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
        """Keep it: the board takes it in its turns."""
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
        """Let the board have one; what it sent in it.

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
    """At least so many bytes, fewer if the next do not come in this time.

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
