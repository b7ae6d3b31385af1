"""The device end of the link in Python."""
