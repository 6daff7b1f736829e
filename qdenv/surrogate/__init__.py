"""The surrogate: a network that predicts the true evaluation of a layout.

    settings     what a user may choose
    networks     maps from maps, numbers from maps; a convolution fast in compiled loops
    samples      true evaluations, the newest in a ring
    surrogate    `Surrogate`: init, fit, predict; losses, learning, errors

Nothing here knows what a layout means.
"""
