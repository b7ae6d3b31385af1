"""What users read about a build, a library, or recordings: tables, report.md and report.json, figures.

`tables` is what commands print, `markdown` the two report files, `transients` and `figures` the drawings. `taps`
shows recordings before anything is solved, `identified` judges a model from a model file, `write` puts all of it into
a folder. `fits` shows what was fitted to records, `device_fit` an identified device.
"""
