"""The surrogate: a network that predicts the true evaluation of a layout.

    settings     what a user may choose
    networks     maps from maps, numbers from maps; a convolution fast in compiled loops
    surrogate    `Surrogate`: init, fit, predict; true evaluations, the newest in a `Ring`

Nothing here knows what a layout means.
"""
