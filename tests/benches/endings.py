"""Methods that never give an answer; in a module that imports little, because the process that runs one loads it."""

import os
import threading


def dies(*_: object) -> None:
    """End the process, as native code does that writes outside its memory."""
    os._exit(134)


def waits(*_: object) -> None:
    """Wait for ever, as native code does that finds no end to its search."""
    threading.Event().wait()
