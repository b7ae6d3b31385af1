"""What a device is, in a file of its owner, and what follows from it for the servo's settings."""
