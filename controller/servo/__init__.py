"""The servo loop, oracle of the compiled core."""
