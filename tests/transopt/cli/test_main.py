"""What all commands share: help that loads nothing to compute with."""

import subprocess
import sys

HELP_OF_EVERY_COMMAND = """
import contextlib, io, sys
import typer
from transopt.cli.main import app

def helped(command, words):
    with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
        command.main([*words, "--help"], prog_name="transopt")
    print(*words)

def walk(command, words=()):
    for name, inner in getattr(command, "commands", {}).items():
        helped(root, [*words, name])
        walk(inner, (*words, name))

root = typer.main.get_command(app)
helped(root, [])
walk(root)
heavy = {"numpy", "scipy", "casadi", "matplotlib", "problems"} & set(sys.modules)
assert not heavy, heavy
"""


def test_help_loads_nothing_to_compute_with() -> None:
    """So that it comes at once, of every command and every command within a command."""
    done = subprocess.run([sys.executable, "-c", HELP_OF_EVERY_COMMAND], check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert {"solve", "compare", "scene keys", "identify device"} <= set(done.stdout.splitlines())
