"""From a scene to a library: every entry solved, explained, priced, verified; grids refined."""
