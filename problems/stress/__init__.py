"""The stress suite: random and directed extreme problems, whose answers are checked by independent means.

`cases` describes a problem by a few numbers, `families` and `draw` choose them, `judge` solves a problem and says how
it ended, `oracle` decides by other means whether a refusal is right, and `run` does all of it in worker processes.
Run it with `python -m problems.stress`.
"""
