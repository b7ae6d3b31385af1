"""The second host of the manual, written from the page of the protocol alone, against the compiled device."""

import socket
import struct
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from controller.host.payload import payload
from controller.protocol import messages as m
from controller.protocol.codes import Kind
from controller.protocol.image import sha256
from controller.protocol.wire import Decoder, encode
from tests.controller.firmware.test_host import served
from transopt.library.library import Library

PROGRAM = Path(__file__).parents[3] / "docs" / "reference" / "second_host.py"


def host(*words: str | Path) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, "-I", str(PROGRAM), *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


@pytest.fixture
def given(library: Library, tmp_path: Path) -> tuple[Path, Path]:
    """Configuration and image as files of bytes."""
    library.save(tmp_path / "library.npz")
    made = payload(tmp_path / "library.npz")
    paths = tmp_path / "configuration.bin", tmp_path / "image.bin"
    for path, data in zip(paths, (made.configuration, made.image), strict=True):
        path.write_bytes(data)
    return paths


@pytest.mark.usefixtures("patient")
def test_it_plays_a_tap(given: tuple[Path, Path]) -> None:
    with served("--vouches") as (_, port):
        done = host(port, *given)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "code 1, 0.2" in done.stdout  # a contact
    assert "code 2," in done.stdout  # and the end of its transient


@pytest.mark.usefixtures("patient")
def test_what_a_host_that_died_was_not_told_is_not_about_its_successor(given: tuple[Path, Path]) -> None:
    """One is killed while it plays: its FINISHED and LEASE_LOST wait for the next one."""
    with served("--vouches") as (_, port):
        command = [sys.executable, "-I", "-u", str(PROGRAM), port, *map(str, given)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as first:
            assert first.stdout is not None
            assert "code 1," in first.stdout.readline()
            first.kill()
            first.wait()
        done = host(port, *given)
    assert done.returncode == 0, done.stdout + done.stderr
    told = [line.partition(": ")[2] for line in done.stdout.splitlines()]
    assert [line.split(",")[0] for line in told[-2:]] == ["code 1", "code 2"]
    assert any(line.startswith("code 32") for line in told[:-2])


@pytest.mark.parametrize("which", [0, 1])
def test_a_file_of_another_version_ends_in_one_line(given: tuple[Path, Path], which: int) -> None:
    data = bytearray(given[which].read_bytes())
    data[4] += 1
    given[which].write_bytes(data)
    done = host("nowhere", *given)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.count("\n") == 1
    assert "version" in done.stderr
    assert "export it again" in done.stderr


class Fake:
    """Answers the requests of one host, and keeps their kinds."""

    def __init__(self, answers: Callable[[Kind], tuple[Kind, bytes]]) -> None:
        self.asked, self._answers = list[Kind](), answers

    def meets(self, given: tuple[Path, Path]) -> "subprocess.CompletedProcess[str]":
        with socket.create_server(("localhost", 0)) as server:
            thread = threading.Thread(target=self._talk, args=(server,))
            thread.start()
            done = host(f"socket://localhost:{server.getsockname()[1]}", *given)
            thread.join(10.0)
        return done

    def _talk(self, server: socket.socket) -> None:
        line, _ = server.accept()
        decoder = Decoder()
        with line:
            while data := line.recv(4096):
                for asked in decoder.feed(data):
                    kind, _, sequence, session = m.HEADER.unpack_from(asked)
                    self.asked.append(Kind(kind))
                    answer, body = self._answers(self.asked[-1])
                    line.sendall(encode(m.HEADER.pack(answer, 0, sequence, session) + body))


def test_a_device_of_another_version_ends_in_one_line(given: tuple[Path, Path]) -> None:
    reply = struct.pack("<IH", m.MAGIC, m.PROTOCOL + 1) + bytes(200)
    done = Fake(lambda _: (Kind.HELLO_REPLY, reply)).meets(given)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.count("\n") == 1
    assert f"the device speaks protocol {m.PROTOCOL + 1}" in done.stderr
    assert "bring host and firmware to one version" in done.stderr


@pytest.mark.parametrize(
    ("there", "sent"),
    [
        ((), [Kind.CONFIGURE, Kind.CONFIGURE_COMMIT, Kind.UPLOAD_BEGIN]),
        ((0,), [Kind.UPLOAD_BEGIN]),
        ((0, 1), [Kind.ARM]),
    ],
)
def test_what_is_in_force_is_not_sent_again(
    given: tuple[Path, Path], there: tuple[int, ...], sent: list[Kind]
) -> None:
    """A CONFIGURE_COMMIT takes the evidence of a check, without which no device that is not simulated arms."""
    hashes = b"".join(sha256(path.read_bytes()) if k in there else bytes(32) for k, path in enumerate(given))
    hello = struct.pack("<IH", m.MAGIC, m.PROTOCOL).ljust(m.HelloReply.FORMAT.size - len(hashes), b"\0") + hashes

    def answers(kind: Kind) -> tuple[Kind, bytes]:
        if kind is Kind.HELLO:
            return Kind.HELLO_REPLY, hello
        if kind in (Kind.UPLOAD_BEGIN, Kind.ARM):
            return Kind.REFUSED, bytes([kind, 8])
        return Kind.DONE, bytes(3)

    device = Fake(answers)
    done = device.meets(given)
    assert device.asked == [Kind.HELLO, *sent]
    assert "was refused for reason 8" in done.stderr


def test_it_ends_in_one_line_where_nobody_is(given: tuple[Path, Path]) -> None:
    done = host("/dev/no-such-port", *given)
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
