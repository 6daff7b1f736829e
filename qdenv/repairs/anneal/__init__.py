"""The annealer: fast feasible layouts whose driving area never falls apart."""
