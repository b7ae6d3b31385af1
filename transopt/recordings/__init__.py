"""Recorded contacts: the first two steps of the walk, from files of a real tap to what the motor has to do.

A file goes from its bytes to a recording through one module after the other:

1. `formats` opens it by its suffix: as text (`text_rows`, `encoding`), as what a library reads (`containers`), as a
   universal file, or as a sound. It gives columns with names, and a rate where the file states one (`rates`).
2. `names` and `units` know what columns are called, and `meanings` says what these mean. What nobody states is a
   question with its answers, `unclear`. `text` and `formats` take the numbers into a `raw_table`.
3. `table` checks them and makes SI signals on one uniform time grid, with the `axes` of a sensor joined.
4. `recording` is the result; `split` parts one that holds several taps.

A recording becomes part of a reference: `tap` finds offset, polarity, onset and speed, with `approach` for how the
hand came; `reference` scales and averages the taps of one speed and grip, and `references` holds those of a scene.
`settings` is the scene's table that says how.
"""
