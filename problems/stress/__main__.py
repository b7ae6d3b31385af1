"""The stress suite: `python -m problems.stress --cases 1000 --seed 1`."""

import sys

from problems.stress.run import main
from transopt.base import terminal

if __name__ == "__main__":
    terminal.run(lambda: sys.exit(main()))
