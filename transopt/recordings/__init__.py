"""Recorded contacts: reading files, finding the onset, and turning taps into references."""
