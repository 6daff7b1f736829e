"""The surrogate: a network that predicts what a true evaluation of a layout would say.

    settings       what a user may choose
    convolution    a convolution whose gradients are fast inside compiled loops
    networks       maps from maps, numbers from maps
    losses         what they make small
    samples        true evaluations, the newest kept
    training       one network after the other, each by Adam
    surrogate      `Surrogate`: init, fit, predict
    report         its losses and errors, as runs log them

Nothing here knows what a layout means or who asks.
"""
