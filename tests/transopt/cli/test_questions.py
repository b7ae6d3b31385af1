"""One question instead of a refusal: in a pseudo-terminal, and without one as a line of options."""

import os
import re
import select
import shlex
import signal
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.benches.commands import Run, assert_refused
from tests.benches.recording_files import text
from tests.benches.tap_formats import SPEED_M_S, TAP_M_S2, TIMES_S
from transopt.base.errors import InputError
from transopt.base.signals import STANDARD_GRAVITY_M_S2 as G
from transopt.cli.questions import answered, plotted, sketched, typed
from transopt.files.unclear import Answer, UnclearError, joined, options
from transopt.recordings.recording import VOCABULARY

pty = pytest.importorskip("pty", reason="pseudo-terminals are POSIX's")
WAIT_S = 60.0  # for an answer of a process; none takes more than some seconds
BARE = "time,acc\n" + text(TIMES_S, TAP_M_S2 / G)


class Person:
    """Someone who types a command into a terminal, and answers."""

    def __init__(self, folder: Path, *command: object) -> None:
        self._written = b""
        self._child, self._terminal = pty.fork()
        if self._child == 0:
            os.chdir(folder)
            os.environ["COLUMNS"] = "100"
            os.execv(sys.executable, [sys.executable, "-m", "transopt", *map(str, command)])

    def _read(self) -> bool:
        ready, _, _ = select.select([self._terminal], [], [], WAIT_S)
        assert ready, f"nothing comes after: {self.seen[-500:]}"
        try:
            piece = os.read(self._terminal, 1 << 16)
        except OSError:  # the other end is closed
            piece = b""
        self._written += piece
        return bool(piece)

    @property
    def seen(self) -> str:
        """What the terminal shows; of a character that has come in part, nothing yet."""
        return self._written.decode(errors="ignore").replace("\r\n", "\n")

    def is_asked(self) -> str:
        """What stands above the prompt."""
        before = len(self.seen)
        while "(needed)" not in self.seen[before:]:
            assert self._read(), self.seen
        return self.seen[before:]

    def types(self, line: str) -> None:
        os.write(self._terminal, line.encode())

    def ends(self) -> int:
        """The exit code."""
        while self._read():
            pass
        os.close(self._terminal)
        return os.waitstatus_to_exitcode(os.waitpid(self._child, 0)[1])


@pytest.fixture
def root(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[3]))


@pytest.mark.usefixtures("root")
class TestTerminal:
    def test_is_shown_asked_and_told_how_to_do_without(self, tmp_path: Path, run: Run) -> None:
        (tmp_path / "tap.csv").write_text(BARE)
        person = Person(tmp_path, "taps", "tap.csv", "--speed", SPEED_M_S, "--scene", "mine.toml")
        shown = person.is_asked()
        assert "time  3000 values, 0 to 0.2999, in steps of 0.0001" in shown
        assert re.search(r"acc   3000 values, -\S+ to 13\.62\n", shown)
        assert shown.count("#") > 60
        assert "1  --units time=s,acceleration=g: 10 kHz, a peak of 13.6 g" in shown
        person.types("nonsense\n")
        assert "write --units time=" in person.is_asked()
        person.types("1\n")
        assert person.ends() == 0, person.seen
        said = re.search(r"the same without being asked: (.*)", person.seen)
        assert said is not None
        scene = (tmp_path / "mine.toml").read_text()
        assert 'units = { time = "s", acceleration = "g" }' in scene
        again = run("taps", tmp_path / "tap.csv", "--speed", SPEED_M_S, *shlex.split(said[1]))
        assert again.code == 0
        assert "13.6" in again.out

    def test_what_is_implausible_is_put_right_or_accepted(self, tmp_path: Path) -> None:
        (tmp_path / "tap.csv").write_text("time_s,acceleration_m_s2\n" + text(TIMES_S, TAP_M_S2 / G))
        person = Person(tmp_path, "taps", "tap.csv", "--speed", SPEED_M_S)
        asked = " ".join(person.is_asked().split())
        assert "check the unit of the acceleration (g called m/s^2?)" in asked
        assert "1 --units acceleration=g: 10 kHz, a peak of 13.6 g, a change of speed by 1" in asked
        assert " 2 --accept: 10 kHz" in asked
        person.types("--accept\n")
        assert person.ends() == 0, person.seen
        assert "the same without being asked: --accept\n" in person.seen

    def test_who_leaves_leaves_nothing_behind(self, tmp_path: Path) -> None:
        (tmp_path / "tap.csv").write_text(BARE)
        person = Person(tmp_path, "taps", "tap.csv", "--speed", SPEED_M_S, "--scene", "mine.toml")
        person.is_asked()
        person.types("\x03")  # Ctrl-C
        assert person.ends() == 128 + signal.SIGINT
        assert "Traceback" not in person.seen
        assert [file.name for file in tmp_path.iterdir()] == ["tap.csv"]


def test_without_a_terminal_a_line_of_options_that_read_it(run: Run) -> None:
    Path("tap.csv").write_text(BARE)
    assert_refused(run("taps", "tap.csv", "--speed", 0.2), "tap.csv", "--units time=s,acceleration=g (10 kHz, a pe")
    # Two facts lack: the options state both.
    Path("tap.csv").write_text("acc [g],accel [g]\n" + text(TAP_M_S2 / G, 0.3 * TAP_M_S2 / G))
    assert_refused(run("taps", "tap.csv", "--speed", 0.2), "--columns 'acc [g],-' --rate-Hz 10000")
    # What is stated already stands in the proposal, since the last --units of a command counts.
    Path("tap.csv").write_text("Time,Ampl\n" + text(TIMES_S, 0.1 * TAP_M_S2 / G))
    stated = ("taps", "tap.csv", "--speed", 0.2, "--units", "Ampl=V @ 100 mV/g")
    refused = run(*stated)
    assert_refused(refused, "--units 'Ampl=V @ 100 mV/g,time=s' (10 kHz, a peak of 1")
    assert run(*stated, "--units", "Ampl=V @ 100 mV/g,time=s").code == 0
    # A range behind a name is no unit, and asked about.
    Path("tap.csv").write_text("Time [s],X (100g)\n" + text(TIMES_S, TAP_M_S2 / G))
    assert_refused(
        run("taps", "tap.csv", "--speed", 0.2, "--columns", "time [s],acc (100g)"), "--units acceleration=g"
    )
    # Two units make nearly the same of a file: the plain one comes first.
    Path("tap.csv").write_text("time [s],acc\n" + text(TIMES_S, TAP_M_S2))
    assert_refused(run("taps", "tap.csv", "--speed", 0.2), "right one: --units 'acceleration=m/s^2'")
    # A file that no answer reads is refused with what the likeliest of them comes to.
    Path("tap.csv").write_text("time,acc\n" + text(TIMES_S, 0 * TIMES_S))
    assert_refused(run("taps", "tap.csv", "--speed", 0.2), "acceleration=m/s^2': recording is constant at 0 m/s^2")


def test_a_response_without_a_unit(run: Run) -> None:
    f = np.linspace(20, 500, 60)
    s = 2j * np.pi * f
    G_g = 30 * s**2 / (s**2 + 2 * np.pi * 150 / 8 * s + (2 * np.pi * 150) ** 2)
    np.savez("r.npz", freq=f, frf=G_g)
    refused = run("plant", "fit", "r.npz", "--order", 2, "--out", "p.npz")
    assert_refused(refused, "variable frf is complex", "--units 'frequency=Hz,frf=m/s^2/A' (60 points, 20 to 500 Hz")
    proposed = re.findall(r"--units '?([^' ]*)", refused.err)
    assert len(proposed) == 3
    for units in proposed:
        assert run("plant", "fit", "r.npz", "--order", 2, "--out", "p.npz", "--units", units).code == 0


class TestAnswers:
    @pytest.mark.parametrize(
        ("line", "example", "answer"),
        [
            ("g", {"units": {"acc": "m/s^2"}}, {"units": {"acc": "g"}}),
            ("--units acc=g,time=ms", {"units": {"acc": "m/s^2"}}, {"units": {"acc": "g", "time": "ms"}}),
            ("10 mV/g", {"units": {"CH1": "V @ 100 mV/g"}}, {"units": {"CH1": "V @ 10 mV/g"}}),
            ("V @ 1 V/g", {"units": {"CH1": "V @ 100 mV/g"}}, {"units": {"CH1": "V @ 1 V/g"}}),
            ("3200", {"rate_Hz": 1e4}, {"rate_Hz": 3200.0}),
            ("--rate-Hz 3200", {"rate_Hz": 1e4}, {"rate_Hz": 3200.0}),
            ("2", {"channel": 1}, {"channel": 2}),
            ("time_s,-,acc_g", {"columns": ["a"]}, {"columns": ["time_s", "-", "acc_g"]}),
        ],
    )
    def test_are_read_as_they_are_typed(self, line: str, example: Answer, answer: Answer) -> None:
        assert typed(line, example) == answer

    @pytest.mark.parametrize(
        ("line", "example"),
        [
            ("fast", {"rate_Hz": 1e4}),
            ("--speed 3", {"rate_Hz": 1e4}),
            ("g", {"units": {"a": "g", "b": "s"}}),
            ("a=", {"units": {"a": "g"}}),
            ("yes", {"implausible": "accept"}),
        ],
    )
    def test_are_asked_for_again(self, line: str, example: Answer) -> None:
        with pytest.raises(ValueError, match=r"."):
            typed(line, example)

    def test_are_joined_column_by_column(self) -> None:
        found = joined({"units": {"a": "g"}, "rate_Hz": None}, {"units": {"b": "s"}, "rate_Hz": 5.0})
        assert found == {"units": {"a": "g", "b": "s"}, "rate_Hz": 5.0}
        assert options(found) == "--units a=g,b=s --rate-Hz 5"

    def test_only_those_that_read_are_proposed_and_facts_that_lack_together_are_stated_together(self) -> None:
        def read(answer: Answer) -> dict[str, Any]:
            if "rate_Hz" not in answer:
                raise UnclearError("no rate", [{"rate_Hz": 1.0}, {"rate_Hz": 2.0}])
            if "channel" not in answer:
                raise UnclearError("no channel", [{"channel": 1}, {"channel": 2}])
            if answer["rate_Hz"] == 1.0:
                raise InputError("not that")
            return dict(answer)

        with pytest.raises(InputError, match="no rate; tried on it") as caught:
            answered(read, VOCABULARY, lambda _: "read")
        assert str(caught.value).endswith("--rate-Hz 2 --channel 1 (read) or --rate-Hz 2 --channel 2 (read)")


def test_a_sketch_shows_what_stands_out() -> None:
    lines = sketched({"t": TIMES_S, "a": TAP_M_S2, "empty": np.full(3, np.nan), "still": np.zeros(9)})
    assert [line.split()[0] for line in lines[:4]] == ["t", "a", "empty", "still"]
    assert lines[2].endswith("no numbers")
    assert lines[4] == "  a:"
    drawn = plotted(np.concatenate([np.zeros(320), np.ones(10), np.zeros(310)]))
    assert all(line.strip("# ") == "" for line in drawn)
    assert drawn[0].index("#") == 2 + 32
    assert len(drawn[-1]) == 2 + 64
