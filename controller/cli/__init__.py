"""The commands `transopt-play` and `transopt-device`, one file per command."""
