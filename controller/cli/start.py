"""Entry points of `transopt-play` and `transopt-device`, which load nothing before they are called."""

from transopt.base.start import start


def play() -> None:
    """`transopt-play`."""
    start("controller.cli.play")


def device() -> None:
    """`transopt-device`."""
    start("controller.cli.device")
