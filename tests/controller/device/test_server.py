"""The Python device behind a port, on a clock of its own."""

import os
import socket
from collections.abc import Iterator
from itertools import count

import pytest

from controller.device.endpoint import Device
from controller.device.server import CHUNK, Listener, Port, Terminal, serve
from controller.protocol import messages as m
from controller.protocol.wire import Decoder, encode
from controller.sim.default_device import DEFAULT_DEVICE
from controller.sim.simulator import Simulator
from controller.sim.user import TapsInTurn
from controller.sim.virtual_link import Link, Trouble
from transopt.base.errors import InputError

DT_S = 1e-4
HELLO = encode(m.Frame(1, 5, m.Hello(m.MAGIC, m.PROTOCOL, 3)).payload())


class Board(Port):
    """What the host wrote beforehand, some bytes at a time; what it would read, of which it takes little at once."""

    def __init__(self, data: bytes) -> None:
        super().__init__("board")
        self._data, self.sent = data, b""
        self._readable, self._writing = os.pipe()
        os.write(self._writing, b"1")

    def fileno(self) -> int:
        return self._readable

    def receive(self) -> bytes:
        piece, self._data = self._data[:7], self._data[7:]
        return piece

    def send(self, data: bytes) -> int:
        self.sent += data[:50]
        return min(len(data), 50)

    def close(self) -> None:
        os.close(self._readable)
        os.close(self._writing)


@pytest.fixture
def simulator() -> Simulator:
    return Simulator(DEFAULT_DEVICE, TapsInTurn([(0.2, 3.0)]), DT_S)


def served(board: Board, simulator: Simulator, looks: int, trouble: Trouble | None = None, **others: float) -> int:
    """Serve for so many looks at a clock that goes on by half a millisecond each; how often the device started."""
    boots, clock, left = count(1), count(), iter(range(looks))
    starts: list[Device] = []

    def start() -> Device:
        starts.append(Device(next(boots)))
        return starts[-1]

    serve(
        start,
        simulator,
        DT_S,
        board,
        Link(trouble),
        going_on=lambda: next(left, None) is not None,
        clock_s=lambda: 5e-4 * next(clock),
        **others,
    )
    board.close()
    return len(starts)


def replies(board: Board) -> list[m.HelloReply]:
    messages = [m.read_frame(payload).message for payload in Decoder().feed(board.sent)]
    return [message for message in messages if isinstance(message, m.HelloReply)]


def test_it_answers_and_time_passes(simulator: Simulator) -> None:
    board = Board(HELLO)
    assert served(board, simulator, 100) == 1
    assert [reply.boot for reply in replies(board)] == [1]
    # 5 ticks a look, but for the first.
    assert simulator.readings().tick == pytest.approx(500, abs=5)


def test_power_goes_off_and_on(simulator: Simulator) -> None:
    again = encode(m.Frame(1, 6, m.Hello(m.MAGIC, m.PROTOCOL, 3)).payload())
    board = Board(HELLO + b"\0" * 2000 + again)
    assert served(board, simulator, 400, reset_every_s=0.05) == 4
    assert [reply.boot for reply in replies(board)] == [1, 3]


def test_a_line_that_loses_all_says_nothing(simulator: Simulator) -> None:
    board = Board(HELLO)
    served(board, simulator, 100, Trouble(loss=1.0))
    assert board.sent == b""


def test_a_clock_that_jumps_is_not_caught_up(simulator: Simulator) -> None:
    times = iter([0.0, *(100.0 + 5e-4 * k for k in range(1000))])
    left = iter(range(100))
    board = Board(b"")
    serve(
        lambda: Device(1),
        simulator,
        DT_S,
        board,
        Link(),
        going_on=lambda: next(left, None) is not None,
        clock_s=lambda: next(times),
    )
    board.close()
    assert simulator.readings().tick < 1100


@pytest.fixture
def listener() -> Iterator[Listener]:
    made = Listener("localhost:0")
    yield made
    made.close()


def test_hosts_come_and_go_on_a_socket(listener: Listener) -> None:
    host, port = listener.name.removeprefix("socket://").split(":")
    assert listener.send(b"to nobody") == 9
    for _ in range(2):
        with socket.create_connection((host, int(port))) as there:
            assert listener.receive() == b""
            there.sendall(b"hello")
            assert listener.receive() == b"hello"
            assert listener.send(b"back") == 4
            assert there.recv(CHUNK) == b"back"
        assert listener.receive() == b""


def test_a_terminal_passes_any_byte() -> None:
    terminal = Terminal()
    there = os.open(terminal.name, os.O_RDWR | os.O_NOCTTY)
    assert terminal.receive() == b""
    data = bytes(range(256))
    assert terminal.send(data) == 256
    assert os.read(there, CHUNK) == data
    os.write(there, data)
    got = b""
    while len(got) < 256:
        got += terminal.receive()
    assert got == data
    os.close(there)
    terminal.close()


@pytest.mark.parametrize(
    "address", ["nowhere", "localhost:", "localhost:x", "localhost:70000", "no.such.host.invalid:1"]
)
def test_addresses_that_cannot_be_had_are_told(address: str) -> None:
    with pytest.raises(InputError, match=rf"^--listen {address}: "):
        Listener(address)
