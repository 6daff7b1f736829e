"""The negotiated planner in XLA, a few agents side by side."""
