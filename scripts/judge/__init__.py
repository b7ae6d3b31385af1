"""A judge of libraries: taps by equations of its own, the figures of them, and tables."""
