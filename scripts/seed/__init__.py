"""Parts of `seed_figures.py`."""
