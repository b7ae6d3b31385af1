"""The physics: stylus, hand, drive, amplifier, coil, circuit, wall, and their exact discretisation."""
