"""The port: pseudo-terminals, sockets, loop; whatever goes wrong is one line, and nothing hangs."""

import contextlib
import errno
import os
import socket
import threading
import tty
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
import serial

from controller.host import transport as t
from controller.host.connection import PortError, UnpluggedError
from controller.host.transport import Transport

WAIT_S = 5.0


@contextlib.contextmanager
def opened() -> Iterator[tuple[int, str]]:
    """A pseudo-terminal that hands on every byte as it is: the end to play with, and the name of the other."""
    try:
        master, slave = os.openpty()
    except OSError as error:
        pytest.skip(f"no pseudo-terminals here: {error}")
    tty.setraw(slave)
    name = os.ttyname(slave)
    yield master, name
    for descriptor in (master, slave):
        with contextlib.suppress(OSError):  # a test may have closed it
            os.close(descriptor)


@pytest.fixture
def pty() -> Iterator[tuple[int, str]]:
    with opened() as both:
        yield both


def read_to_the_end(port: Transport) -> None:
    while True:
        port.read(WAIT_S)


def read_all(port: Transport, size: int) -> bytes:
    data = b""
    while len(data) < size:
        block = port.read(WAIT_S)
        assert block, f"{len(data)} of {size} bytes came"
        data += block
    return data


def test_a_pseudo_terminal_carries_every_byte_both_ways(pty: tuple[int, str]) -> None:
    master, name = pty
    every = bytes(range(256))
    with Transport(name) as port:
        port.write(every)
        assert os.read(master, 1000) == every
        os.write(master, every)
        assert read_all(port, 256) == every
        assert port.read(0.0) == b""


def test_much_data_is_not_lost(pty: tuple[int, str]) -> None:
    master, name = pty
    data = os.urandom(300_000)

    def send() -> None:
        place = 0
        while place < len(data):
            place += os.write(master, data[place : place + 1000])

    with Transport(name) as port:
        sender = threading.Thread(target=send)
        sender.start()
        assert read_all(port, len(data)) == data
        sender.join(WAIT_S)


def test_a_socket_carries_every_byte_both_ways() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        name = f"socket://127.0.0.1:{server.getsockname()[1]}"
        with Transport(name) as port:
            peer, _ = server.accept()
            with peer:
                peer.settimeout(WAIT_S)
                port.write(bytes(range(256)))
                assert peer.recv(1000) == bytes(range(256))
                peer.sendall(bytes(100_000))
                assert read_all(port, 100_000) == bytes(100_000)
            with pytest.raises(UnpluggedError, match="the connection is gone"):
                read_to_the_end(port)


def test_unplugged_while_open_is_told_after_what_came_before(pty: tuple[int, str]) -> None:
    master, name = pty
    port = Transport(name)
    os.write(master, b"last words")
    assert read_all(port, 10) == b"last words"
    os.close(master)
    with pytest.raises(UnpluggedError, match=r"the connection is gone .*: plug the device in again"):
        read_to_the_end(port)
    with pytest.raises(UnpluggedError):
        port.write(b"x")
    port.close()
    port.close()
    with pytest.raises(UnpluggedError, match="closed"):
        port.read(0.0)


@pytest.mark.parametrize(
    "failure",
    [OSError(errno.EIO, "Input/output error"), serial.SerialException("gone"), TypeError("None"), ArithmeticError()],
)
def test_a_reader_never_dies_silently(pty: tuple[int, str], failure: Exception) -> None:
    """Whatever the port throws in its thread reaches whoever reads."""
    master, name = pty
    port = Transport(name)

    def throw(size: int) -> bytes:
        raise failure

    port._port.read = throw  # type: ignore[method-assign]
    os.write(master, b"x")
    with pytest.raises(UnpluggedError):
        read_to_the_end(port)
    port.close()


def test_a_port_that_takes_nothing_is_told(pty: tuple[int, str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(t, "WRITE_TIMEOUT_S", 0.05)
    _, name = pty
    with Transport(name) as port, pytest.raises(UnpluggedError, match="taken no data"):
        port.write(bytes(1_000_000))


def test_the_time_for_writing_is_that_of_a_piece(pty: tuple[int, str], monkeypatch: pytest.MonkeyPatch) -> None:
    """An upload's window of 17 kB takes 1.5 s at 115200 baud, and nobody may call that silence."""
    _, name = pty
    pieces: list[bytes] = []
    with Transport(name) as port:
        monkeypatch.setattr(port._port, "write", pieces.append)
        data = bytes(range(256)) * 66
        port.write(data)
    assert b"".join(pieces) == data
    assert max(map(len, pieces)) * 10 / 115_200 < t.WRITE_TIMEOUT_S / 4


def test_busy(pty: tuple[int, str]) -> None:
    _, name = pty
    with Transport(name), pytest.raises(PortError, match="busy: another program has it open"):
        Transport(name)
    Transport(name).close()


def test_a_port_without_a_description_has_none(monkeypatch: pytest.MonkeyPatch) -> None:
    listed = [SimpleNamespace(device="/dev/ttyS0", description="n/a", vid=None)]  # as pyserial says it
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: listed)
    assert t.listed_ports() == [t.Listed("/dev/ttyS0", "")]


def test_no_such_port_lists_those_there_are(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(t, "listed_ports", lambda: [t.Listed("/dev/ttyACM7", "Teensy")])
    with pytest.raises(PortError, match=r"/dev/ttyNONE: no such port; there are /dev/ttyACM7"):
        Transport("/dev/ttyNONE")
    monkeypatch.setattr(t, "listed_ports", list)
    with pytest.raises(PortError, match="there is no serial port at all"):
        Transport("/dev/ttyNONE")


def test_no_permission_names_the_group(monkeypatch: pytest.MonkeyPatch) -> None:
    def denied(*arguments: object, **options: object) -> None:
        raise serial.SerialException(errno.EACCES, "could not open port /dev/ttyACM0: Permission denied")

    monkeypatch.setattr(serial, "serial_for_url", denied)
    with pytest.raises(PortError, match=r"/dev/ttyACM0: no permission: .*dialout"):
        Transport("/dev/ttyACM0")


@pytest.mark.parametrize("name", ["nonsense://x", "socket://nowhere", "socket://127.0.0.1:notaport"])
def test_not_a_port(name: str) -> None:
    with pytest.raises(PortError, match=name.split(":", maxsplit=1)[0]):
        Transport(name)


def test_a_file_is_no_port(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"")
    with pytest.raises(PortError):
        Transport(str(path))


def test_nobody_listens() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        number = server.getsockname()[1]
    with pytest.raises(PortError, match="nobody answers there"):
        Transport(f"socket://127.0.0.1:{number}")


@pytest.mark.parametrize(
    ("name", "port", "baud"),
    [
        ("/dev/ttyUSB0@4000000", "/dev/ttyUSB0", 4_000_000),
        ("COM12@921600", "COM12", 921_600),
        ("/dev/ttyACM0", "/dev/ttyACM0", t.BAUD),
        ("socket://me@host:1", "socket://me@host:1", t.BAUD),
    ],
)
def test_a_name_may_have_its_rate_behind_it(name: str, port: str, baud: int) -> None:
    assert t.without_rate(name) == (port, baud)


@pytest.mark.parametrize("name", ["/dev/ttyUSB0@", "/dev/ttyUSB0@fast", "/dev/ttyUSB0@0", "/dev/ttyUSB0@99000000"])
def test_a_rate_that_is_none(name: str) -> None:
    with pytest.raises(PortError, match="behind @ stands the rate in baud"):
        Transport(name)


@pytest.mark.parametrize("name", ["COM3", r"\\.\COM12"])
def test_a_port_of_windows_that_is_open_elsewhere_is_busy(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Windows calls that a lack of permission, and has no group that would help."""

    def refused(*_: object, **__: object) -> None:
        raise t.serial.SerialException(
            f"could not open port {name!r}: PermissionError(13, 'Access is denied.', None, 5)"
        )

    monkeypatch.setattr(t.serial, "serial_for_url", refused)
    with pytest.raises(PortError, match="busy: another program has it open"):
        Transport(name)
