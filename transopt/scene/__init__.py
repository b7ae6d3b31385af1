"""Scene files: sections, keys, bounds, and the identified models that a scene may name."""
