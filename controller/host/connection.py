"""The interface of a line to a device, and the errors common to all lines.

`controller.host.transport.Transport` is a serial port, `controller.host.emulated.EmulatedPort` the line to a board in
an emulator, `controller.sim.port.SimulatedPort` the port `sim:` with a simulated device. Everything above,
`controller.host.driver.Device` and the commands, is the same for all.
"""

from typing import Protocol

from transopt.base.errors import InputError

CLOCK = ",clock="  # between the two names of an emulated board's port


class PortError(InputError):
    """The port cannot be opened or used; the message is one line with a remedy."""


class UnpluggedError(PortError):
    """The port disappeared while it was open; `detail` is the system's message."""

    def __init__(self, message: str, detail: str = "") -> None:
        super().__init__(message)
        self.detail = detail


class Connection(Protocol):
    """A stream of bytes each way, and the clock by which its user waits.

    Attributes
    ----------
    name : name of the port in errors and tables.
    harmless : whether the device moves nothing and touches nobody, so that it needs no bring-up check.
    """

    @property
    def name(self) -> str: ...

    @property
    def harmless(self) -> bool: ...

    def now_s(self) -> float:
        """Time of a monotonic clock; in a simulation it advances while `read` waits."""
        ...

    def read(self, timeout_s: float) -> bytes:
        """Read the bytes that have come, after waiting at most `timeout_s` for the first; empty if none came.

        Raises
        ------
        UnpluggedError : the port is gone, and all bytes that came before have been read.
        """
        ...

    def write(self, data: bytes) -> None:
        """
        Raises
        ------
        UnpluggedError : the port is gone or accepts no more data.
        """
        ...

    def close(self) -> None:
        """Close the port, in any state; may be called repeatedly."""
        ...
