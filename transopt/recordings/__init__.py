"""Recorded contacts: taps on real objects, as files hold them, made ready for a reference.

`recording` reads one file through `transopt.files`, `axes` joins the axes of its sensor, and `split` cuts a file that
holds several taps. `tap` finds offset, polarity, onset and `speed`, `approach` the motion of the hand before contact.
Doubts come from `plausible` and `after_contact`. `settings` is the scene's table for all of this.
"""
