"""Lifelong multi-agent path finding: a fleet on one layout, and the planners that move it."""
