"""The project's own interior point in C, and the door to it."""
