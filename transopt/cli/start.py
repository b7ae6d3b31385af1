"""Entry points of the commands, which load nothing before they are called.

Those of `transopt-play` and `transopt-device` stand here, and name the package `controller` without importing it: a
file `controller.py` that Python finds before it would be in the way of an entry point inside the package.
"""

from transopt.base.start import start


def transopt() -> None:
    """`transopt`."""
    start("transopt.cli.main")


def play() -> None:
    """`transopt-play`."""
    start("controller.cli.play")


def device() -> None:
    """`transopt-device`."""
    start("controller.cli.device")
