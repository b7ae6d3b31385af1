"""The Python device on a pseudo-terminal or a socket, for machines without a C compiler.

Too slow for 10 kHz in real time on most machines: its time then passes more slowly than the clock's, evenly, and the
host's estimate of the device's clock says by how much.
"""

import os
import select
import socket
import time
from collections.abc import Callable
from contextlib import suppress

from controller.device.endpoint import Device
from controller.protocol.wire import DELIMITER
from controller.servo.interface import Plant
from controller.sim.virtual_link import Link
from transopt.base.errors import InputError

CHUNK = 8192
BATCH_S = 1e-3  # of device time between two looks at the link
BEHIND_MOST_S = 0.05  # more is not caught up


class Port:
    """Bytes to and from one host at a time, never waiting; `name` is what the host opens."""

    def __init__(self, name: str) -> None:
        self.name = name

    def fileno(self) -> int:
        """What becomes readable when there is something to do."""
        raise NotImplementedError

    def receive(self) -> bytes:
        raise NotImplementedError

    def send(self, data: bytes) -> int:
        """How much of it went out; without a host all of it, to nobody."""
        raise NotImplementedError

    def close(self) -> None:
        raise NotImplementedError


class Terminal(Port):
    """A pseudo-terminal.

    Raises
    ------
    InputError : there is none to be had.
    """

    def __init__(self) -> None:
        try:
            import tty

            self._ours, self._theirs = os.openpty()
            tty.setraw(self._theirs)
        except (ImportError, OSError) as error:
            raise InputError(f"no pseudo-terminal to be had ({error}): use --listen HOST:PORT") from None
        os.set_blocking(self._ours, False)
        super().__init__(os.ttyname(self._theirs))

    def fileno(self) -> int:
        return self._ours

    def receive(self) -> bytes:
        with suppress(BlockingIOError):
            return os.read(self._ours, CHUNK)
        return b""

    def send(self, data: bytes) -> int:
        with suppress(BlockingIOError):
            return os.write(self._ours, data)
        return 0

    def close(self) -> None:
        os.close(self._ours)
        os.close(self._theirs)


class Listener(Port):
    """A TCP socket; a host that comes while another is there waits.

    Raises
    ------
    InputError : the address is no address, or cannot be had.
    """

    def __init__(self, address: str) -> None:
        host, colon, port = address.rpartition(":")
        if not colon or not port.isdigit() or int(port) > 65535:
            raise InputError(f"--listen {address}: must be HOST:PORT")
        try:
            self._server = socket.create_server((host, int(port)))
        except OSError as error:
            raise InputError(f"--listen {address}: cannot be had ({error}); choose another port") from None
        self._server.setblocking(False)
        self._client: socket.socket | None = None
        super().__init__(f"socket://{host or 'localhost'}:{self._server.getsockname()[1]}")

    def fileno(self) -> int:
        return (self._server if self._client is None else self._client).fileno()

    def receive(self) -> bytes:
        if self._client is None:
            with suppress(BlockingIOError):
                self._client, _ = self._server.accept()
                self._client.setblocking(False)
                self._client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            return b""
        try:
            data = self._client.recv(CHUNK)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._drop()
        return data

    def send(self, data: bytes) -> int:
        if self._client is None:
            return len(data)
        try:
            return self._client.send(data)
        except BlockingIOError:
            return 0
        except OSError:
            self._drop()
            return len(data)

    def close(self) -> None:
        if self._client is not None:
            self._drop()
        self._server.close()

    def _drop(self) -> None:
        assert self._client is not None
        self._client.close()
        self._client = None


def serve(
    start: Callable[[], Device],
    plant: Plant,
    dt_s: float,
    port: Port,
    link: Link,
    *,
    reset_every_s: float = 0.0,
    going_on: Callable[[], bool] = lambda: True,
    clock_s: Callable[[], float] = time.monotonic,
) -> None:
    """Serve until `going_on` says no; it is asked every millisecond.

    Parameters
    ----------
    start : a device as it is after power on. reset_every_s : power off and on so often; 0 for never.
    link : the line's troubles between port and device.
    """
    device, whole, leaving = start(), b"", b""
    began_s = clock_s()
    ticks, reset_at_s = 0, began_s + reset_every_s
    while going_on():
        now_s = clock_s()
        if reset_every_s and now_s >= reset_at_s:
            device, reset_at_s = start(), now_s + reset_every_s
        began_s = max(began_s, now_s - ticks * dt_s - BEHIND_MOST_S)
        whole += port.receive()
        cut = whole.rfind(DELIMITER) + 1
        link.host_sends(whole[:cut], now_s)
        whole = whole[cut:][-CHUNK:]
        device.receive(link.to_device.arrived(now_s))
        due = min(int((now_s - began_s) / dt_s) - ticks, round(BATCH_S / dt_s))
        for _ in range(due):
            plant.advance(device.step(plant.readings()).command_A)
            ticks += 1
        link.device_sends(device.bytes_to_send(), now_s)
        leaving += link.to_host.arrived(now_s)
        leaving = leaving[port.send(leaving) :] if leaving else leaving
        if due < 1:
            select.select([port], [], [], BATCH_S)
