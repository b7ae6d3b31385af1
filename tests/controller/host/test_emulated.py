"""The line to an emulated board: time passes by turns that the host gives, and whatever goes wrong is one line."""

import os
import threading
from collections.abc import Iterator

import pytest

from controller.host import emulated as e
from controller.host.connection import CLOCK, PortError, UnpluggedError
from controller.host.driver import _opened
from controller.host.emulated import TURN_S, EmulatedPort
from tests.controller.host.test_transport import opened

WAIT_S = 5.0


class Board:
    """Says a word in the turns that it is given; heard what has been written to it."""

    def __init__(self, port: tuple[int, str], clock: tuple[int, str]) -> None:
        (self.port, name), (self.clock, clock_name) = port, clock
        self.name = f"{name}{CLOCK}{clock_name}"
        self.turns, self.words, self.heard = 0, dict[int, bytes](), b""
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while len(said := os.read(self.clock, 2)) == 2 and said != b"xx":
            self.turns += 1
            self.heard += os.read(self.port, size) if (size := int.from_bytes(said, "little")) else b""
            word = self.words.get(self.turns, b"")
            os.write(self.clock, len(word).to_bytes(2, "little"))
            if word:
                os.write(self.port, word)

    def end(self, connection: EmulatedPort) -> None:
        os.write(connection._open[1], b"xx")
        self._thread.join(WAIT_S)


@pytest.fixture
def board() -> Iterator[Board]:
    with opened() as port, opened() as clock:
        yield Board(port, clock)


def test_time_passes_only_while_the_host_waits(board: Board) -> None:
    with_port = EmulatedPort(board.name)
    assert with_port.now_s() == board.turns == 0
    assert with_port.read(4 * TURN_S) == b""
    assert with_port.now_s() == pytest.approx(4 * TURN_S)
    assert board.turns == 4
    board.end(with_port)
    with_port.close()


def test_what_comes_ends_a_wait_and_what_goes_waits_for_a_turn(board: Board) -> None:
    board.words[3] = b"third"
    port = EmulatedPort(board.name)
    port.write(b"to the board")
    assert port.read(10 * TURN_S) == b"third"
    assert board.turns == 3
    assert port.now_s() == pytest.approx(3 * TURN_S)
    assert board.heard == b"to the board"
    board.end(port)
    port.close()
    port.close()
    for use in (lambda: port.write(b"x"), lambda: port.read(0.0)):
        with pytest.raises(UnpluggedError, match="the emulator is gone"):
            use()


def test_an_emulator_that_ends_or_stands_still_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(e, "STANDSTILL_S", 0.02)
    with opened() as (_, name), opened() as (clock, clock_name):
        port = EmulatedPort(f"{name}{CLOCK}{clock_name}")
        with pytest.raises(UnpluggedError, match="stands still"):
            port.read(1.0)
        os.close(clock)
        with pytest.raises(UnpluggedError, match="the emulator is gone"):
            port.read(1.0)
        port.close()


def test_the_name_of_a_port_says_which_kind_it_is(board: Board) -> None:
    port = _opened(board.name)
    assert isinstance(port, EmulatedPort)
    assert not port.harmless
    board.end(port)
    port.close()
    with pytest.raises(PortError, match=r"/dev/none.*No such file.*: give the terminals"):
        _opened(f"/dev/none{CLOCK}/dev/none")
