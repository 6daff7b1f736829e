"""Random words by number, and tables to draw with. Compiled by numba.

A word is a hash of the seed and its number (SplitMix64: Steele, Lea and Flood 2014,
https://doi.org/10.1145/2660193.2660195): no word waits for the one before it, and a run that is cut
into pieces draws what it would have drawn in one.
"""

import numpy as np

from qdenv.native import formula

WORDS = 8  # random words that one move may use
LEVELS = 1024
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX = (np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB))
_U27, _U30, _U31 = (np.uint64(bits) for bits in (27, 30, 31))
# How far a rise in energy may go at temperature 1, for equally likely draws of exp(-rise): a table
# spares each move an exponential.
LIMITS = -np.log((np.arange(LEVELS) + 0.5) / LEVELS)


@formula
def word(seed: np.uint64, number: int) -> np.uint64:
    """Draw 64 random bits."""
    x = np.uint64(seed) + np.uint64(number) * _GOLDEN
    x = (x ^ (x >> _U30)) * _MIX[0]
    x = (x ^ (x >> _U27)) * _MIX[1]
    return x ^ (x >> _U31)


@formula
def bits(source: np.uint64, first: int, count: int) -> int:
    """Take `count` of a word's bits, from bit `first` on, as a number."""
    return int(np.int64(source >> np.uint64(first)) & ((1 << count) - 1))


@formula
def below(source: np.uint64, first: int, count: int, bound: int) -> int:
    """Draw from 0 .. bound - 1 with `count` of a word's bits, by their high end: no division."""
    return bits(source, first, count) * bound >> count
