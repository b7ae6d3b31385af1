"""`transopt page`: one clear line where it cannot serve, and an end within a second where it does."""

import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.benches.commands import Run, assert_refused
from transopt.web.server import MISSING

EXTRA = ("starlette", "uvicorn", "websockets")
ENDS_S = 5.0  # a second, on a machine that is busy with other things too


@pytest.fixture
def _extra() -> None:
    for name in EXTRA:
        pytest.importorskip(name, reason="the extra `page` is not installed")


@pytest.mark.usefixtures("_extra")
def test_a_file_that_is_none_is_refused(run: Run) -> None:
    Path("letter.npz").write_bytes(b"Dear reader")
    Path("letter.toml").write_text("Dear reader")
    for name in ("letter.npz", "letter.toml", "nowhere.toml", "nowood"):
        assert_refused(run("page", name), name)


@pytest.mark.usefixtures("_extra")
def test_a_port_that_is_taken_is_refused(run: Run) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        assert_refused(run("page", "lra_click", "--port", taken.getsockname()[1]), "--port", "choose another")


@pytest.mark.usefixtures("_extra")
def test_recordings_that_are_missing_are_refused(run: Run) -> None:
    assert_refused(run("page", "measured_impacts"), "--recordings")
    assert_refused(run("page", "measured_impacts", "--recordings", "nowhere"), "--recordings nowhere: no such folder")


@pytest.mark.parametrize("name", EXTRA)
def test_without_the_extra_it_is_said_what_to_install(run: Run, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    monkeypatch.setitem(sys.modules, name, None)
    assert_refused(run("page", "lra_click"), MISSING)


@pytest.mark.usefixtures("_extra")
@pytest.mark.skipif(sys.platform == "win32", reason="no SIGINT for another process there")
def test_ctrl_c_ends_it_within_a_second() -> None:
    words = [sys.executable, "-m", "transopt", "page", "lra_click"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as served:
        assert served.stdout is not None
        assert served.stderr is not None
        address = served.stdout.readline().split(": ", 1)[1].strip()
        assert served.stdout.readline()
        port = int(address.split(":")[2].split("/")[0])
        with socket.create_connection(
            ("127.0.0.1", port), timeout=30
        ) as held:  # that somebody is there does not hold it
            held.sendall(b"GET / HTTP/1.1\r\nHost: nobody\r\n\r\n")
            assert b"403" in held.recv(100)
            began = time.monotonic()
            served.send_signal(signal.SIGINT)
            assert served.wait(timeout=30) == 130
        assert time.monotonic() - began < ENDS_S
        assert served.stderr.read() == ""
