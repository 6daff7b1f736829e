"""The reservations of a window on the host: who holds which cells and moves.

One word per cell holds all its reservations in the window: plane p at timestep t is bit
``PLANE * p + t``, with the planes of `xla`. So a search reads one word per step. Reserved
paths never conflict, hence every bit has one owner and is set and cleared by flipping it.
"""

from typing import NamedTuple

import numpy as np

from qdenv.grid import NUM_MOVES
from qdenv.native import formula, kernel
from qdenv.simulate.mapf.host.state import GridMap
from qdenv.simulate.mapf.negotiated import rules
from qdenv.simulate.mapf.planner import NOBODY

PLANE = 12  # bits of a plane: a window of at most ten steps, and five planes below the sign
WALL = -1 << 63  # the sign: a wall
# Where in a word those stand who leave against each move.
_AGAINST = np.array([PLANE * rules.opposite(move) for move in range(NUM_MOVES)])


class ReservationWords(NamedTuple):
    """Who has reserved what; w steps are planned, A agents, N cells."""

    word: np.ndarray  # int64 [N], the planes of every cell, and `WALL`
    # int32 [N, w + 1], who was the last to reserve a cell at a time; holds it as long as the bits
    # say so
    owner: np.ndarray
    path: np.ndarray  # int64 [A, w + 1], the latest path of every agent
    steps: np.ndarray  # int64 [A], steps of that path that are reserved


def make_reservations(grid: GridMap, agents: int, window: int) -> ReservationWords:
    """Make the reservations of a window."""
    cells = grid.free.size
    return ReservationWords(
        np.zeros(cells, np.int64),
        np.empty((cells, window + 1), np.int32),
        np.zeros((agents, window + 1), np.int64),
        np.zeros(agents, np.int64),
    )


@kernel
def clear(reservations: ReservationWords, grid: GridMap) -> None:
    """Begin a window: nothing is reserved."""
    for cell in range(grid.free.size):
        reservations.word[cell] = 0 if grid.free[cell] else WALL


@formula
def is_taken(word: int, t: int, move: int) -> int:
    """Return whether arriving in a cell by a move, from t to t + 1, conflicts (0 or 1)."""
    here = word >> t
    # Who leaves the cell against the move would be swapped with.
    return (here | (here >> _AGAINST[move])) & 1


@formula
def is_reserved(word: int, t: int) -> int:
    """Return whether an agent is in a cell at t + 1 (0 or 1)."""
    return (word >> t) & 1


@formula
def _flip(reservations: ReservationWords, agent: int, steps: int, width: int) -> None:
    """Set the bits of the first steps of an agent's path, or clear them."""
    path, word = reservations.path, reservations.word
    for t in range(steps):
        before, after = path[agent, t], path[agent, t + 1]
        word[after] ^= 1 << t
        plane = rules.move_plane(after - before, width)
        if plane:
            word[before] ^= 1 << (PLANE * plane + t)


@kernel
def reserve(reservations: ReservationWords, agent: int, steps: int, width: int) -> None:
    """Reserve the first steps of the path of an agent that holds nothing."""
    reservations.steps[agent] = steps
    _flip(reservations, agent, steps, width)
    for t in range(steps + 1 if steps else 0):
        reservations.owner[reservations.path[agent, t], t] = agent


@kernel
def release(reservations: ReservationWords, agent: int, width: int) -> None:
    """Remove what an agent has reserved."""
    _flip(reservations, agent, reservations.steps[agent], width)
    reservations.steps[agent] = 0


@formula
def holder(reservations: ReservationWords, cell: int, t: int) -> int:
    """Find who is in a cell at t + 1, or `NOBODY`."""
    if is_reserved(reservations.word[cell], t):
        return reservations.owner[cell, t + 1] + 0
    return NOBODY


@formula
def swapped_with(
    reservations: ReservationWords, before: int, after: int, t: int, width: int
) -> int:
    """Find who would be swapped with by a step at t, or `NOBODY`."""
    plane = rules.opposite(rules.move_plane(after - before, width))
    if plane and reservations.word[after] >> (PLANE * plane + t) & 1:
        return reservations.owner[after, t] + 0
    return NOBODY
