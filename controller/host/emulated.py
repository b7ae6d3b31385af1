"""The line to a board in an emulator, whose time passes only while the host waits for it.

A port of the name `PORT,clock=PORT2` is one: two pseudo-terminals of the emulator. On the second the host gives the
board its turns, `TURN_S` of its time each, byte by byte, and the board says by a byte that it is through. So no
deadline depends on how fast the emulator is, or on what else the machine has to do.
"""

import os
import select

from controller.host.connection import PortError, UnpluggedError

CLOCK, TURN_S = ",clock=", 5e-3  # as port/stm32f405/emulated.c has it
STANDSTILL_S = 30.0  # in which a turn has to be through
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
        self.name, self._turns, self._given = name, 0, False
        self._leaving, self._open = b"", list[int]()
        try:
            for terminal in name.split(CLOCK):
                self._open.append(os.open(terminal, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK))
        except OSError as error:
            self.close()
            raise PortError(f"{name}: {error.strerror}: give the terminals that the emulator has printed") from None

    def now_s(self) -> float:
        return TURN_S * self._turns

    def read(self, timeout_s: float) -> bytes:
        end_s = self.now_s() + timeout_s
        while True:
            port, clock = self._terminals()
            try:
                data = _waiting(port) or self._turn(port, clock)
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
        if self._leaving and select.select([], [port], [], 0)[1]:
            self._leaving = self._leaving[os.write(port, self._leaving) :]
        if not self._given:
            self._given = os.write(clock, b".") == 1
        if not select.select([clock], [], [], STANDSTILL_S)[0]:
            raise OSError("its clock stands still")
        passed = os.read(clock, BLOCK_BYTES)
        if not passed:
            raise OSError("its clock is gone")
        self._turns, self._given = self._turns + len(passed), False
        return _waiting(port)

    def _gone(self, detail: str) -> UnpluggedError:
        return UnpluggedError(f"{self.name}: the emulator is gone ({detail}): start it again", detail)


def _waiting(port: int) -> bytes:
    """Bytes that have come."""
    return os.read(port, BLOCK_BYTES) if select.select([port], [], [], 0)[0] else b""
