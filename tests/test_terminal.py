"""What all command lines do with words they do not know: one line, exit code 2."""

import importlib
import subprocess
import sys

import pytest

MAINS = {"transopt": "transopt.cli", "transopt-play": "controller.cli", "transopt-device": "controller.device_cli"}


def call(program: str, arguments: str, monkeypatch: pytest.MonkeyPatch) -> object:
    monkeypatch.setattr(sys, "argv", [program, *arguments.split()])
    with pytest.raises(SystemExit) as stop:
        importlib.import_module(MAINS[program]).main()
    return stop.value.code


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("transopt solve --jobs abc", "valid integer"),
        ("transopt solve --speedd 3", "No such option: --speedd"),
        ("transopt nosuch", "No such command 'nosuch'"),
        ("transopt verify", "Missing argument"),
        ("transopt-play tap x.npz --simulate --speed abc", "'--speed'"),
        ("transopt-device --nothing", "No such option: --nothing"),
    ],
)
def test_one_line(line: str, words: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    program, arguments = line.split(" ", 1)
    assert call(program, arguments, monkeypatch) == 2
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1
    assert said[0].startswith("error: ")
    assert words in said[0]
    assert f"`{program}" in said[0]
    assert "--help` lists what there is" in said[0]


@pytest.mark.parametrize(("line", "code"), [("transopt", 2), ("transopt --help", 0), ("transopt-play record", 2)])
def test_help_once(line: str, code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    program, _, arguments = line.partition(" ")
    assert call(program, arguments, monkeypatch) == code
    captured = capsys.readouterr()
    assert (captured.out + captured.err).count("Usage:") == 1


def test_the_version(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert call("transopt", "--version", monkeypatch) == 0
    assert capsys.readouterr().out.strip().count(".") >= 1


@pytest.mark.parametrize("module", MAINS.values())
def test_help_comes_at_once(module: str) -> None:
    """No command line loads what only its commands need."""
    program = f"import sys, {module}; print(sorted({{'numpy', 'scipy', 'casadi', 'matplotlib'}} & set(sys.modules)))"
    said = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True).stdout
    assert said.strip() == "[]"
