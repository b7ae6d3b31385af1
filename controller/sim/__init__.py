"""The simulated world: a true device, its sensors and its user."""
