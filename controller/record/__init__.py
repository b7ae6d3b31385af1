"""Recordings made while the device plays, and their comparison with the library's predictions."""
