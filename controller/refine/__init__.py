"""Learning from played taps: rounds of correction, their tables and figure."""
