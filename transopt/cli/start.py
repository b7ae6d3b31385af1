"""Entry point of `transopt`, which loads nothing before it is called."""

from transopt.base.start import start


def transopt() -> None:
    """`transopt`."""
    start("transopt.cli.main")
