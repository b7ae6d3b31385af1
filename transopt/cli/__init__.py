"""The command `transopt`, one file per command; the only room that knows the built-in problems."""
