"""Entry points of the commands, which load nothing before they are called.

Those of `transopt-play` and `transopt-device` stand here, and name the package `controller` without importing it: a
file `controller.py` that Python finds before it would be in the way of an entry point inside the package.
"""

from transopt.base.start import start

# The commands of the two programs that a person types; each of them names the other where it lacks one of these.
COMMANDS = {
    "transopt": (
        "taps",
        "solve",
        "verify",
        "show",
        "compare",
        "export",
        "study",
        "page",
        "scene",
        "plant",
        "identify",
    ),
    "transopt-play": (
        *("ports", "doctor", "upload", "monitor", "check", "zero", "refine", "calibrate", "tap", "record", "device"),
    ),
}


def transopt() -> None:
    """`transopt`."""
    start("transopt.cli.main")


def play() -> None:
    """`transopt-play`."""
    start("controller.cli.play")


def device() -> None:
    """`transopt-device`."""
    start("controller.cli.device")
