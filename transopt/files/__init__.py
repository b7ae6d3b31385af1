"""Files of numbers: from the bytes that an instrument or a logger wrote to named channels in SI.

Recordings of taps, frequency responses and logs of a device are read here, each with its own vocabulary. Reading
takes these steps:

1. `formats` opens a file by its suffix: as text (`encoding`, `text_rows`, `text`), as variables (`containers`,
   `mat5`), as a universal file (`universal_file`), or as a sound.
2. `names` and `units` know the names and units in use, `statements` what lines say in words, and `meanings` maps
   columns to quantities. What nobody states becomes a question with possible answers (`unclear`).
3. The result is a `raw_table`: columns in the file's own units. `table` turns one over time into SI signals on one
   uniform grid.

Nothing here knows what a tap, a plant or a problem is.
"""
