"""Recorded contacts: the first two steps of the walk, from files of a real tap to what the motor has to do.

`recording` reads a file with the help of `formats` and `table`; `tap` finds offset, polarity, onset and speed, with
`approach` for how the hand came; `reference` scales and averages the taps of one speed and grip, and `references`
holds those of a scene. `settings` is the scene's table that says how.
"""
