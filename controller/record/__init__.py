"""What was measured while the device played, and how it compares with what its library says."""
