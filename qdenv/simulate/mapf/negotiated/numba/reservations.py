"""The book of a window on the host: who has reserved which cells and moves.

Reservations lie in words of 64 columns that start every 32, so that the 21 columns around any cell
lie within one word. Reserved paths never conflict, hence every bit has one owner and is entered
and struck out by flipping it.

    table   int64 [w, H', words, 5], planes as in `reservation`
    owner   int32 [w + 1, N], the agent at each cell and time, or `NOBODY`
    paths   int64 [A, w + 1], the latest path of every agent
    until   int64 [A], timesteps of the path that are reserved
"""

import numpy as np

from qdenv.native import compiled
from qdenv.simulate.mapf.negotiated.xla.reservations import NOBODY

STRIDE = 32  # columns between the starts of neighbouring words
PLANES = 5


@compiled
def pack(traversable):
    """Pack a map of cells into words of 64 columns that start every 32 (int64 [H', words])."""
    rows, width = traversable.shape
    words = np.zeros((rows, width // STRIDE + 2, 1), np.int64)
    for row in range(rows):
        for column in range(width):
            if traversable[row, column]:
                flip(words, row, column, 0)
    return words.reshape(words.shape[:2])


@compiled
def flip(planes, row, column, plane):
    """Flip one cell in one plane (int64 [H', words, planes]), in the words that hold it."""
    word, bit = column // STRIDE, column % STRIDE
    planes[row, word, plane] ^= 1 << bit
    if word:
        planes[row, word - 1, plane] ^= 1 << (bit + STRIDE)


@compiled
def reserve(table, path, steps, width):
    """Flip the first steps of a path: enter them, or strike them out."""
    for t in range(steps):
        before, after = path[t], path[t + 1]
        flip(table[t], after // width, after % width, 0)
        change = after - before
        if change:
            plane = 1 if change == 1 else 2 if change == -1 else 3 if change == width else 4
            flip(table[t], before // width, before % width, plane)


@compiled
def enter(table, owner, paths, until, agent, path, steps, width):
    """Write the path of an agent who holds nothing into the book and reserve its first steps."""
    paths[agent] = path
    until[agent] = steps
    reserve(table, path, steps, width)
    for t in range(steps + 1 if steps else 0):
        owner[t, path[t]] = agent


@compiled
def strike_out(table, owner, paths, until, agent, width):
    """Remove what an agent has reserved."""
    steps = until[agent]
    if steps > 0:
        reserve(table, paths[agent], steps, width)
        for t in range(steps + 1):
            owner[t, paths[agent, t]] = NOBODY
        until[agent] = 0


@compiled
def evict(table, owner, paths, until, path, width):
    """Strike out everybody whose reservations a path drives over."""
    for t in range(1, path.size):
        met, there = owner[t, path[t]], owner[t - 1, path[t]]
        if met != NOBODY:
            strike_out(table, owner, paths, until, met, width)
        if there != NOBODY and owner[t, path[t - 1]] == there:
            strike_out(table, owner, paths, until, there, width)
