"""What a person reads of a build, a library, or recordings: tables, report.md and report.json, figures.

`tables` is what commands print, `markdown` the two report files, `transients` and `figures` the drawings, `taps` a
look at recordings before anything is solved, `identified` what to think of a model from a model file, `write`
puts all of it into a folder. What was just fitted to records is shown by `fits`, a device by
`device_fit`.
"""
