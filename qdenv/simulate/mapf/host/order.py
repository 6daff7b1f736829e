"""Order agents by a number: compiled host code that makes no arrays."""

import numpy as np

from qdenv.native import formula, kernel

AGENT_BITS = 24


@formula
def ranked(number: int, agent: int) -> int:
    """Pack a number (0 to 2^38) and an agent: packs sort by number, then by agent."""
    return (number << AGENT_BITS) | agent


@formula
def agent_of(pack: int) -> int:
    """Read the agent of a pack."""
    return pack & ((1 << AGENT_BITS) - 1)


@kernel
def sort(values: np.ndarray) -> None:
    """Sort int64 [n] in place, the smallest first (heapsort; Williams 1964).

    https://doi.org/10.1145/512274.512284
    """
    size = values.size
    for first in range(size // 2 - 1, -1, -1):
        _sift(values, first, size)
    for last in range(size - 1, 0, -1):
        values[0], values[last] = values[last], values[0]
        _sift(values, 0, last)


@kernel
def _sift(values: np.ndarray, hole: int, size: int) -> None:
    """Let the value at `hole` sink below all larger ones."""
    value = values[hole]
    while 2 * hole + 1 < size:
        child = 2 * hole + 1
        if child + 1 < size and values[child + 1] > values[child]:
            child += 1
        if values[child] <= value:
            break
        values[hole], hole = values[child], child
    values[hole] = value
