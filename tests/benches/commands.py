"""Command lines run as a user runs them, in this process."""

import importlib
import io
import sys
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass

import pytest

MAINS = {
    "transopt": "transopt.cli.main",
    "transopt-play": "controller.cli.play",
    "transopt-device": "controller.cli.device",
    "problems.stress": "problems.stress.__main__",
}


@dataclass(frozen=True)
class Outcome:
    """Outcome of one run of a command."""

    code: int
    out: str
    err: str


Run = Callable[..., Outcome]  # a program's name, if it is not bound already, and its arguments


class Terminal:
    """Terminal in which commands are typed and what they print is read."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
        self._monkeypatch, self._capsys = monkeypatch, capsys

    def __call__(self, program: str, *arguments: object) -> Outcome:
        self._monkeypatch.setattr(sys, "argv", [program, *map(str, arguments)])
        code = 0
        try:
            importlib.import_module(MAINS[program]).main()
        except SystemExit as stop:
            code = int(stop.code or 0)
        captured = self._capsys.readouterr()
        return Outcome(code, captured.out, captured.err)


def captured(program: str, *arguments: object) -> Outcome:
    """Run a command in this process without the fixtures of a test."""
    out, err, code = io.StringIO(), io.StringIO(), 0
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setattr(sys, "argv", [program, *map(str, arguments)])
        try:
            importlib.import_module(MAINS[program]).main()
        except SystemExit as stop:
            code = int(stop.code or 0)
    return Outcome(code, out.getvalue(), err.getvalue())


def assert_refused(outcome: Outcome, *words: str) -> None:
    """Exit code 2 and one line that says what, and no traceback."""
    assert outcome.code == 2, outcome.err
    lines = [line for line in outcome.err.splitlines() if "━" not in line]
    assert len(lines) == 1, outcome.err
    assert lines[0].startswith("error: ")
    for word in words:
        assert word in lines[0], lines[0]
