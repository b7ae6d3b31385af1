"""What the compiled servo is told, what it is told by, and the rules by which it gives up."""
