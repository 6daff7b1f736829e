"""The simulators: fleets of robots, and one agent in a maze."""
