"""Parts of the campaigns against devices."""
