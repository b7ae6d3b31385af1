"""The line to a device as the host sees it, and the errors that every line has.

`controller.host.transport.Transport` is a serial port, `controller.host.emulated.EmulatedPort` that of a board in an
emulator, `controller.sim.port.SimulatedPort` the port `sim:`, a device that is computed. Everything above,
`controller.host.driver.Device` and the commands, is the same for all.
"""

from typing import Protocol

from transopt.base.errors import InputError

CLOCK = ",clock="  # between the two names of an emulated board's port


class PortError(InputError):
    """The port cannot be opened or used; the message is one line with what to do."""


class UnpluggedError(PortError):
    """The port went away while it was open; `detail` is what the system said of it."""

    def __init__(self, message: str, detail: str = "") -> None:
        super().__init__(message)
        self.detail = detail


class Connection(Protocol):
    """A stream of bytes each way, and the clock by which its user waits.

    Attributes
    ----------
    name : of the port, as errors and tables show it.
    harmless : nothing is moved and nobody is touched: a device there needs no bring-up check.
    """

    @property
    def name(self) -> str: ...

    @property
    def harmless(self) -> bool: ...

    def now_s(self) -> float:
        """Time of a clock that only grows; in a simulation it grows while `read` waits."""
        ...

    def read(self, timeout_s: float) -> bytes:
        """What has come, waiting for the first byte for so long at most; empty if nothing came.

        Raises
        ------
        UnpluggedError : the port is gone, and all that came before has been read.
        """
        ...

    def write(self, data: bytes) -> None:
        """
        Raises
        ------
        UnpluggedError : the port is gone, or takes nothing any more.
        """
        ...

    def close(self) -> None:
        """Whatever state it is in, any number of times."""
        ...
