"""The stress suite: `python -m problems.stress --cases 1000`."""

import typer

from problems.stress.run import stress
from transopt.base import terminal


def main() -> None:
    """Run the command line."""
    app = typer.Typer(add_completion=False)
    app.command()(stress)
    terminal.run(app)


if __name__ == "__main__":
    main()
