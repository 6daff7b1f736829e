"""PIBT: priority inheritance with backtracking, one timestep at a time."""
