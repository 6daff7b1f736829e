"""PBS: priority-based search over windows, the planner of the published simulator (RHCR)."""
