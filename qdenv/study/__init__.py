"""Studies of saved layouts and runs: traffic, sweeps, comparisons, sizes, elites."""
