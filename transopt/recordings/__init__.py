"""Recorded contacts: taps on real objects, as files hold them, made ready for a reference.

`recording` reads one file through `transopt.files`, `axes` joins the axes of its sensor, and `split` cuts a file that
holds several taps. `onset` finds offset, polarity and contact, `speed` and `approach` the hand's motion before it.
Doubts come from `plausible` and `after_contact`. `tap` puts these together, by the scene's table in `settings`.
"""
