"""Plays libraries by independent equations of motion, for `played_against_real.py`: taps, figures, tables."""
