"""Commands in pseudo-terminals of given widths, as a person runs them; a program of its own, which forks.

    python -m tests.benches.widths < '[[["transopt", "solve"], [60, 80]], ...]'

prints, as JSON, a list for each command: what it printed into the terminal of each width, and its exit code. A
process for each would import everything anew; a fork has it already.
"""

import fcntl
import importlib
import json
import os
import pty
import struct
import sys
import termios

from tests.benches.commands import MAINS

ROWS = 50
# What the commands import when they run.
LOADED = (
    "transopt.design.verify",
    "transopt.report.first",
    "transopt.report.write",
    "transopt.study.session",
    "rich",
)


def printed(command: list[str], width: int) -> tuple[str, int]:
    """What a command prints into a terminal of a width, and its exit code; its messages go nowhere."""
    child, terminal = pty.fork()
    if child == 0:
        fcntl.ioctl(1, termios.TIOCSWINSZ, struct.pack("HHHH", ROWS, width, 0, 0))
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        # The objects of the process that was forked know another file.
        sys.stdin, sys.stdout, sys.stderr = map(os.fdopen, (0, 1, 2), ("r", "w", "w"))
        sys.argv = command
        code = 1
        try:
            importlib.import_module(MAINS[command[0]]).main()
        except SystemExit as stop:
            code = int(stop.code or 0)
        finally:
            sys.stdout.flush()
            os._exit(code)
    pieces = []
    while True:
        try:
            piece = os.read(terminal, 1 << 16)
        except OSError:  # the other end is closed
            break
        if not piece:
            break
        pieces.append(piece)
    os.close(terminal)
    _, status = os.waitpid(child, 0)
    return b"".join(pieces).decode().replace("\r\n", "\n"), os.waitstatus_to_exitcode(status)


def main() -> None:
    """Run what standard input asks for."""
    asked = json.load(sys.stdin)
    for name in (*LOADED, *MAINS.values()):
        importlib.import_module(name)
    print(json.dumps([[printed(command, width) for width in widths] for command, widths in asked]))


if __name__ == "__main__":
    main()
