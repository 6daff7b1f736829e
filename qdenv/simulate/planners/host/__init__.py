"""The windowed planner's bargaining, compiled for one core of the host."""
