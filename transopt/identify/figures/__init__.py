"""Figures of what was identified: one file for each of amplifier, device, hand and coil."""
