"""What a Ctrl-C does to a command that is still being loaded."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

INTERRUPTED = "import os, signal, time\nos.kill(os.getpid(), signal.SIGINT)\ntime.sleep(60)\n"


@pytest.mark.skipif(os.name != "posix", reason="a signal cannot be sent to oneself")
@pytest.mark.parametrize(
    ("module", "command"),
    [("transopt.cli.start", "transopt"), ("controller.cli.start", "play"), ("controller.cli.start", "device")],
)
def test_while_it_is_loaded_it_ends_without_a_traceback(tmp_path: Path, module: str, command: str) -> None:
    # In place of the library that takes longest to load, one that is interrupted.
    (tmp_path / "typer.py").write_text(INTERRUPTED)
    paths = os.pathsep.join([str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])])
    program = f"from {module} import {command}; {command}()"
    ended = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "PYTHONPATH": paths},
        capture_output=True,
        text=True,
        timeout=50,
        check=False,
    )
    assert ended.returncode == -signal.SIGINT
    assert ended.stderr == ""
