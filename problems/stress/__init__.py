"""The stress suite: random and directed extreme problems, whose answers are checked by independent means.

`cases` describes a problem by a few numbers, `families` and `draw` choose them, `judge` solves a problem and says how
it ended, and `oracle` decides by other means whether a refusal is right. Run it with
`python -m problems.stress`.
"""
