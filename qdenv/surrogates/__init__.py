"""The surrogate: a network that predicts the true evaluation of a layout.

Nothing here knows what a layout means.
"""
