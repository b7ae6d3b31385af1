"""Modules of `seed_figures.py`."""
