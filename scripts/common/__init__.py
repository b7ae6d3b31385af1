"""Code shared by several scripts."""
