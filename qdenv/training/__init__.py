"""Training: the loop of a search, its configuration, its run directory."""
