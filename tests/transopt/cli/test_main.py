"""What all commands share: help with an example, which loads nothing to compute with; the first steps."""

import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest
import typer

from controller.cli import device, play
from tests.benches.commands import Terminal, assert_refused
from transopt.cli import main

HELP_OF_EVERY_COMMAND = """
import contextlib, io, sys
import typer
from {module} import app

def helped(command, words):
    with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
        command.main([*words, "--help"], prog_name="{program}")
    print(*words)

def walk(command, words=()):
    for name, inner in getattr(command, "commands", {{}}).items():
        helped(root, [*words, name])
        walk(inner, (*words, name))

root = typer.main.get_command(app)
helped(root, [])
walk(root)
heavy = {{"numpy", "scipy", "casadi", "matplotlib", "serial", "problems"}} & set(sys.modules)
assert not heavy, heavy
"""
PROGRAMS = {"transopt": main.app, "transopt-play": play.app, "transopt-device": device.app}
COMMANDS = {
    "transopt": {"solve", "compare", "scene keys", "identify device"},
    "transopt-play": {"tap", "upload", "record sweep"},
    "transopt-device": {""},
}


def commands(command: Any, words: tuple[str, ...]) -> Iterator[tuple[str, Any]]:
    """What is typed and the command that answers, for a program, its groups and all commands in them."""
    yield " ".join(words), command
    for name, inner in getattr(command, "commands", {}).items():
        yield from commands(inner, (*words, name))


EVERY = {
    words: command
    for program, app in PROGRAMS.items()
    for words, command in commands(typer.main.get_command(app), (program,))
}


@pytest.mark.parametrize("program", PROGRAMS)
def test_help_loads_nothing_to_compute_with(program: str) -> None:
    """So that it comes at once, of every command and every command within a command."""
    module = next(
        name
        for name in ("transopt.cli.main", "controller.cli.play", "controller.cli.device")
        if sys.modules[name].app is PROGRAMS[program]
    )
    script = HELP_OF_EVERY_COMMAND.format(module=module, program=program)
    done = subprocess.run([sys.executable, "-c", script], check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert COMMANDS[program] <= set(done.stdout.splitlines())


@pytest.mark.parametrize("words", EVERY)
def test_every_help_ends_with_an_example_that_its_command_takes(words: str) -> None:
    line = (EVERY[words].epilog or "").removeprefix("Example: ").split()
    typed = words.split()
    assert line[: len(typed)] == typed, f"{words} --help shows no example of itself"
    # A group's example is one of its commands'. Parsed as if typed, without being run.
    named = max((other.split() for other in EVERY if line[: len(other.split())] == other.split()), key=len)
    EVERY[" ".join(named)].make_context(named[-1], line[len(named) :])


@pytest.mark.parametrize("words", ["plant fit", "plant sweep", "taps", "identify hand"])
def test_help_with_long_words_is_whole_on_80_columns(
    words: str, terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    outcome = terminal("transopt", *words.split(), "--help")
    assert "--columns" in outcome.out
    assert "…" not in outcome.out


@pytest.mark.parametrize(
    ("program", "words"), [("transopt", "transopt solve\n"), ("transopt-play", "transopt-play tap ")]
)
def test_alone_a_program_says_by_three_commands_what_to_do_first(
    program: str, words: str, terminal: Terminal
) -> None:
    outcome = terminal(program)
    assert outcome.code == 0
    assert outcome.out.startswith(words)
    lines = outcome.out.splitlines()
    assert sum(line.startswith("transopt") for line in lines) == 3
    assert max(map(len, lines)) <= 80


@pytest.mark.parametrize(
    ("line", "meant"),
    [
        ("transopt slove", "solve"),
        ("transopt scene kys", "keys"),
        ("transopt-play recrod tap", "record"),
        ("transopt solve --soler riccati", "--solver"),
        ("transopt solve wood", "wood_on_foam"),
        ("transopt solve --solver ricati", "riccati"),
        ("transopt study --set limits.slew_A_s=1 --vary lead_ms=1 --out x", "limits.slew_A_per_s"),
        ("transopt study --study grip --out x", "grip_mismatch"),
        ("transopt-play tap x.npz --simulate --method online-", "online"),
        ("transopt-play tap x.npz --simulate --user stop", "stops"),
        ("transopt-play record sweep --simulate --out x --for amplifer", "amplifier"),
        ("transopt-play check --port x --skip encodr", "encoder"),
    ],
)
def test_an_unknown_word_suggests_the_nearest(line: str, meant: str, terminal: Terminal) -> None:
    program, *arguments = line.split()
    assert_refused(terminal(program, *arguments), f"(did you mean {meant}")
