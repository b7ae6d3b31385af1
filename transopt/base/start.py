"""The first steps of a command, whose loading takes some tenths of a second in which a Ctrl-C may come."""

import signal
from importlib import import_module


def start(module: str) -> None:
    """Load the module of a command line and call its `main`.

    Until the command line answers signals itself (`transopt.base.terminal.run`), a Ctrl-C ends the process as it ends
    any other program; Python's own answer would be a traceback from the middle of an import. A Ctrl-C that is
    ignored, as in the background of a shell, stays ignored.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    import_module(module).main()
