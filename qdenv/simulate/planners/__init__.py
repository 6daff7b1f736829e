"""Planners: a block of timesteps for all agents."""
