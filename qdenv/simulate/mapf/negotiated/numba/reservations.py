"""The reservation table of a window on the host: who holds which cells and moves.

Reservations lie in words of 64 columns that start every 32, so that the 21 columns around any cell
lie within one word. Reserved paths never conflict, hence every bit has one owner and is set and
cleared by flipping it.
"""

from typing import NamedTuple

import numpy as np

from qdenv.native import compiled, inlined
from qdenv.simulate.mapf.negotiated import rules
from qdenv.simulate.mapf.planner import NOBODY
from qdenv.types import Array

STRIDE = 32  # columns between the starts of neighbouring words


class Reservations(NamedTuple):
    """Who has reserved what; w is the window.

    Attributes:
        table: int64 [w, H', words, 5], planes as in `xla.bitplanes`.
        owner: int32 [w + 1, H' * W'], the agent at each cell and time, or `NOBODY`.
        paths: int64 [A, w + 1], the latest path of every agent.
        reserved_steps: int64 [A], steps of that path that are reserved.
        width: W', columns of the padded grid.
    """

    table: np.ndarray
    owner: np.ndarray
    paths: np.ndarray
    reserved_steps: np.ndarray
    width: int


@compiled
def pack(traversable: np.ndarray) -> np.ndarray:
    """Pack a map of cells into words of 64 columns that start every 32 (int64 [H', words])."""
    rows, width = traversable.shape
    words = np.zeros((rows, width // STRIDE + 2, 1), np.int64)
    for row in range(rows):
        for column in range(width):
            if traversable[row, column]:
                flip(words, row, column, 0)
    return words.reshape(words.shape[:2])


@inlined
def flip(planes: np.ndarray, row: int, column: int, plane: int) -> None:
    """Flip one cell in one plane (int64 [H', words, planes]), in the words that hold it."""
    word, bit = column // STRIDE, column % STRIDE
    planes[row, word, plane] ^= 1 << bit
    if word:
        planes[row, word - 1, plane] ^= 1 << (bit + STRIDE)


@compiled
def no_reservations(words: np.ndarray, width: int, previous: Array) -> Reservations:
    """Begin without any; everybody counts as if they had their path.

    Args:
        words: int64 [H', words], any map packed by `pack`.
        width: W'.
        previous: int32 [w + 1, A], the latest paths.
    """
    window, count = previous.shape[0] - 1, previous.shape[1]
    paths = np.empty((count, window + 1), np.int64)
    paths[:] = previous.T
    return Reservations(
        np.zeros((window, words.shape[0], words.shape[1], rules.MOVES), np.int64),
        np.full((window + 1, words.shape[0] * width), NOBODY, np.int32),
        paths,
        np.full(count, window),
        width,
    )


@inlined
def flip_path(reservations: Reservations, path: np.ndarray, steps: int) -> None:
    """Set the bits of the first steps of a path, or clear them."""
    table, width = reservations.table, reservations.width
    for t in range(steps):
        before, after = path[t], path[t + 1]
        flip(table[t], after // width, after % width, 0)
        plane = rules.move_plane(after - before, width)
        if plane:
            flip(table[t], before // width, before % width, plane)


@inlined
def reserve(reservations: Reservations, agent: int, path: np.ndarray, steps: int) -> None:
    """Reserve the first steps of the path of an agent who holds nothing."""
    reservations.paths[agent] = path
    reservations.reserved_steps[agent] = steps
    flip_path(reservations, path, steps)
    for t in range(steps + 1 if steps else 0):
        reservations.owner[t, path[t]] = agent


@inlined
def release(reservations: Reservations, agent: int) -> None:
    """Remove what an agent has reserved."""
    path, steps = reservations.paths[agent], reservations.reserved_steps[agent]
    if steps > 0:
        flip_path(reservations, path, steps)
        for t in range(steps + 1):
            reservations.owner[t, path[t]] = NOBODY
        reservations.reserved_steps[agent] = 0


@compiled
def evict(reservations: Reservations, path: np.ndarray) -> None:
    """Release everybody whose reservations a path drives over."""
    owner = reservations.owner
    for t in range(1, path.size):
        met, ahead = owner[t, path[t]], owner[t - 1, path[t]]
        if met != NOBODY:
            release(reservations, met)
        if rules.is_swapped(ahead, owner[t, path[t - 1]]):
            release(reservations, ahead)
