"""`python -m transopt`: the command `transopt`, where the folder of commands is not on the path."""

from transopt.cli.start import transopt

transopt()
