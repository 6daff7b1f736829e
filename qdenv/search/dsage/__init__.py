"""DSAGE: tiles are searched directly, on a surrogate that true evaluations teach.

settings      what a user may choose
tiles         random solutions and their mutations
inner         the inner loop: MAP-Elites on the surrogate
downsample    which of its elites are evaluated truly
dsage         the outer loop as `init / ask / tell`
"""
