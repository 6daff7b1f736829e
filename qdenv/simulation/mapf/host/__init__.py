"""Whole runs of a simulation in compiled host code: what all planners share."""
