"""`python -m controller`: the command `transopt-play`, where the folder of commands is not on the path."""

from transopt.cli.start import play

play()
