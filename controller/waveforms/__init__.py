"""Waveforms that a tap may be played with, and what they are predicted to do."""
