"""Recorded contacts: the first two steps of the walk, from files of a real tap to what the motor has to do.

`recording` reads a file with the help of `formats` and `table`; `tap` finds offset, polarity, onset and speed;
`reference` scales and averages the taps of one speed and splits off the user's own motion. `settings` is the scene's
table that says how. A reference is what the optimal-control problem tracks.
"""
