"""The device from current and acceleration: chain fit, black box, validation."""
