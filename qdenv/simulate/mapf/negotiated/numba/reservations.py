"""The reservations of a window on the host: which agents hold which cells and moves.

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

PLANE = 12  # bits of a plane: a window of at most ten steps, and five planes below the sign
WALL = -1 << 63  # the sign: a wall
# Where in a word those stand who leave against each move.
_AGAINST = np.array([PLANE * rules.opposite(move) for move in range(NUM_MOVES)])


class ReservationWords(NamedTuple):
    """What each agent has reserved; w steps are planned, A agents, N cells."""

    word: np.ndarray  # int64 [N], the planes of every cell, and `WALL`
    # int32 [N, w + 1], the last agent to reserve a cell at a time; holds it as long as the bits
    # say so
    owner: np.ndarray
    path: np.ndarray  # int64 [A, w + 1], the latest path of every agent
    steps: np.ndarray  # int64 [A], steps of that path that are reserved


def make_reservations(grid: GridMap, agents: int, window: int) -> ReservationWords:
    """Make the reservations of a window, none yet."""
    return ReservationWords(
        np.where(grid.free, 0, WALL),
        np.empty((grid.free.size, window + 1), np.int32),
        np.zeros((agents, window + 1), np.int64),
        np.zeros(agents, np.int64),
    )


@formula
def is_taken(word: int, t: int, move: int) -> int:
    """Return whether arriving in a cell by a move, from t to t + 1, conflicts (0 or 1)."""
    here = word >> t
    # An agent that leaves the cell against the move would be swapped with.
    return (here | (here >> _AGAINST[move])) & 1


@kernel
def reserve(reservations: ReservationWords, agent: int, steps: int, width: int) -> None:
    """Reserve the first steps of the path of an agent that holds nothing; 0 to release it."""
    path, word = reservations.path, reservations.word
    # Setting a bit and clearing it are the same flip: one of the two numbers is 0.
    for t in range(steps + reservations.steps[agent]):
        before, after = path[agent, t], path[agent, t + 1]
        word[after] ^= 1 << t
        plane = rules.move_plane(after - before, width)
        if plane:
            word[before] ^= 1 << (PLANE * plane + t)
    reservations.steps[agent] = steps
    for t in range(steps + 1 if steps else 0):
        reservations.owner[path[agent, t], t] = agent
