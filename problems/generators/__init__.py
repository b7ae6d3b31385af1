"""Generators of simulated recordings."""
