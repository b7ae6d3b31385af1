"""What was measured while the device played, and how it is judged."""
