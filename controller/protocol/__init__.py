"""Bytes on the wire: frames, messages, configuration and image."""
