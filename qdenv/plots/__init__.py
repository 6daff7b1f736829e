"""Figures, drawn from saved runs and layouts."""
