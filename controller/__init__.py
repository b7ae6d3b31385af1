"""Plays a library on a device: the runtime side of the project."""
