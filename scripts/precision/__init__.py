"""Modules of `error_against_runtime.py`."""
