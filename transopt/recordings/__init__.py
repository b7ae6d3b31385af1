"""Recorded contacts: from files of a real tap to its reference, the motion that the motor has to produce.

A file becomes a recording in these steps:

1. `formats` opens it by its suffix: as text (`text_rows`, `encoding`), by a library (`containers`), as a universal
   file, or as a sound. It yields named columns, and a sample rate where the file states one (`rates`).
2. `names` and `units` know the names and units in use, `meanings` maps columns to quantities, and `unclear` turns
   what nobody states into a question with possible answers. `text` and `formats` put the numbers into a `raw_table`.
3. `table` checks them and makes SI signals on one uniform time grid, joining the `axes` of a sensor.
4. `recording` is the result; `split` cuts one that holds several taps.

A recording becomes part of a reference: `tap` finds offset, polarity, onset and speed, `approach` the motion of the
hand before contact. `reference` scales and averages the taps of one speed and grip; `references` holds the references
of a scene. `settings` is the scene's table for all of this.
"""
