"""The hand from taps: mass, damping and stiffness over grip force."""
