"""The stress suite: random and directed extreme problems, whose answers are checked independently of the solvers.

`cases` describes a problem by a few numbers, `families` and `draw` choose them, and `judge` solves a problem and
classifies the outcome. `oracle` checks refusals by a separate method, and `run` runs the suite in worker processes.
Run it with `python -m problems.stress`.
"""
