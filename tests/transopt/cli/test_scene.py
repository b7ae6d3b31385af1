"""`transopt scene` and `transopt page`."""

import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

import problems
from tests.benches.commands import Run, assert_refused
from transopt.web.server import MISSING

WOOD = problems.scene_path("wood_on_foam").read_text()


class TestScene:
    def test_list_names_every_scene_and_what_it_shows(self, run: Run) -> None:
        outcome = run("scene", "list")
        assert outcome.code == 0
        for name in problems.scene_names():
            assert name in outcome.out

    def test_show_prints_the_file(self, run: Run) -> None:
        assert run("scene", "show", "wood_on_foam").out == WOOD

    def test_new_copies_and_the_copy_solves(self, run: Run) -> None:
        outcome = run("scene", "new", "mine.toml", "--from", "wood_on_foam")
        assert outcome.code == 0
        assert "transopt solve mine.toml" in outcome.out
        text = Path("mine.toml").read_text()
        assert text == WOOD
        Path("mine.toml").write_text(
            text.replace("[0.1, 0.2, 0.3, 0.4]", "[0.2]").replace("[1.0, 3.0, 5.0]", "[3.0]")
        )
        assert run("solve", "mine.toml", "--no-figures").code == 0
        assert Path("out/mine/library.npz").exists()

    def test_refusals(self, run: Run) -> None:
        assert_refused(run("scene", "show", "wood"), "no built-in scene", "wood_on_foam")
        assert_refused(run("scene", "new", "mine.txt"), "ends in .toml")
        assert_refused(run("scene", "new", "absent/mine.toml"), "cannot be written")
        assert_refused(run("scene", "new", "mine.toml", "--from", "nope"), "nope", "no built-in scene")
        assert not Path("mine.toml").exists()

    def test_keys_with_unit_default_value_and_bounds(self, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
        from rich.console import Console

        monkeypatch.setattr("transopt.base.terminal.console", lambda: Console(width=200))
        outcome = run("scene", "keys")
        assert outcome.code == 0
        rows = rows_of(outcome.out)
        assert rows["limits.slew_A_per_s"][2] == "A/s"
        assert rows["time.stages"][1:5] == ["800", "", "-", ">= 2, <= 20000 or none"]
        assert rows["model.stylus_mass_kg"][3] == "to be stated"
        Path("mine.toml").write_text(WOOD.replace("beta = 3.2", "beta = 2.5"))
        assert rows_of(run("scene", "keys", "mine.toml").out)["limits.beta"][1] == "2.5"
        assert_refused(run("scene", "keys", "absent"), "absent", "no built-in scene")

    def test_keys_of_taps_and_of_targets_are_those_that_apply(self, run: Run) -> None:
        """At 80 columns the value of a key stands beside it, in the first block."""
        struck, recorded, clicks = (
            rows_of(run("scene", "keys", each).out) for each in ("wood_on_foam", "own_taps", "lra_click")
        )
        own = "recordings.simulated.repeats"
        assert own in struck
        assert own not in recorded
        assert "recordings.lowpass_Hz" in recorded
        assert not any(key.startswith("recordings.") for key in clicks)
        for taps in (struck, recorded):
            assert not any(key.startswith("targets.") for key in taps)
        assert any(key.startswith("targets.") for key in clicks)


def rows_of(printed: str) -> dict[str, list[str]]:
    """The cells of a printed table by the first of their row."""
    rows = [[cell.strip() for cell in line.split("│")[1:-1]] for line in printed.splitlines() if "│" in line]
    return {cells[0]: cells for cells in rows}


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
