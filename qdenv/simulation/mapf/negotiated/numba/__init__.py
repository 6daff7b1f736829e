"""The negotiated planner compiled by numba, one agent at a time."""
