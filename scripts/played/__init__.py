"""What a library does on the real object: taps by equations of their own, their figures, and tables."""
