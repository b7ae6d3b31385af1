"""The command `transopt`, one file per command."""
