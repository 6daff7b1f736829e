"""The negotiated planner: settings, rules shared by both backends, and the backends."""
