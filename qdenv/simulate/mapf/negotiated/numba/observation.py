"""What one planning agent sees around it, as words of bits.

A set of cells is the square of E = 2 w + 1 rows and columns around the agent (w is the window), as
many whole rows to a word as fit into 63 bits, with an empty word on either side: W + 2 words.
"""

from typing import NamedTuple

import numpy as np

from qdenv.native import compiled, inlined
from qdenv.simulate.mapf.negotiated import rules
from qdenv.simulate.mapf.negotiated.numba.reservations import STRIDE, Reservations

BITS = 63


class Grid(NamedTuple):
    """What of a layout the search needs.

    Attributes:
        walls: int64 [H', words], the packed traversable cells.
        distance: int16 [G, H' * W'], steps from every cell to every goal.
        goals: int32 [G], the goal cells.
        width: W'.
    """

    walls: np.ndarray
    distance: np.ndarray
    goals: np.ndarray
    width: int


class Agent(NamedTuple):
    """Who plans.

    Attributes:
        position: cell of the padded grid.
        goal: slots of the current and of the next goal.
        service_time: timesteps to serve at each.
        remaining_service: timesteps still to serve where the agent is; 0 while driving.
        penalty: cost of a conflict.
        noise: random bits that settle ties.
    """

    position: int
    goal: tuple[int, int]
    service_time: tuple[int, int]
    remaining_service: int
    penalty: int
    noise: int


class VisibleGoal(NamedTuple):
    """Where a goal is in the local window.

    Attributes:
        row: -1 where it is not in sight or ends no leg.
        column: likewise.
        word: the word of a set that holds it; 0 (always empty) where not in sight.
        bit: its bit in that word; 0 where not in sight.
    """

    row: int
    column: int
    word: int
    bit: int


class Workspace(NamedTuple):
    """The arrays of one search; L conflict levels.

    Attributes:
        rows: int64 [E, 2], the word of every row and the bit where it begins.
        traversable: int64 [W + 2], cells without walls.
        conflicting: int64 [w, W + 2, 5], cells where arriving at t + 1 by each move conflicts.
        expandable: int64 [L, 2, w + 1, W + 2], cells that paths go on from at time t.
        clashing: the same, cells reached at time t by a step with a conflict.
        served: int64 [L, 2, w + 1], bit e: serving for e timesteps at time t.
    """

    rows: np.ndarray
    traversable: np.ndarray
    conflicting: np.ndarray
    expandable: np.ndarray
    clashing: np.ndarray
    served: np.ndarray


@compiled
def make_workspace(window: int, levels: int) -> Workspace:
    """Allocate the arrays of a search."""
    side = 2 * window + 1
    per_word = BITS // side
    rows = np.empty((side, 2), np.int64)
    for row in range(side):
        rows[row, 0], rows[row, 1] = row // per_word + 1, row % per_word * side
    words = rows[-1, 0] + 2
    return Workspace(
        rows,
        np.zeros(words, np.int64),
        np.zeros((window, words, rules.MOVES), np.int64),
        np.zeros((levels, 2, window + 1, words), np.int64),
        np.zeros((levels, 2, window + 1, words), np.int64),
        np.zeros((levels, 2, window + 1), np.int64),
    )


@inlined
def gather(work: Workspace, reservations: Reservations, grid: Grid, position: int) -> None:
    """Cut out what the agent at `position` sees: walls and conflicts with reservations."""
    window, side = work.conflicting.shape[0], work.rows.shape[0]
    top, left = position // grid.width - window, position % grid.width - window
    begin, skip = left // STRIDE, left % STRIDE
    sight, per_word = (1 << side) - 1, BITS // side
    rows, table = work.rows, reservations.table
    work.traversable[:] = 0
    for i in range(side):
        work.traversable[rows[i, 0]] |= ((grid.walls[top + i, begin] >> skip) & sight) << rows[i, 1]
    for t in range(window):
        # No path is farther out than t + 1 rows at time t + 1.
        first, last = window - t - 1, window + t + 1
        for word in range(rows[first, 0], rows[last, 0] + 1):
            cell, right, left, down, up = 0, 0, 0, 0, 0
            for i in range(max(first, (word - 1) * per_word), min(last + 1, word * per_word)):
                seen, shift = table[t, top + i, begin], rows[i, 1]
                cell |= ((seen[0] >> skip) & sight) << shift
                right |= ((seen[1] >> skip) & sight) << shift
                left |= ((seen[2] >> skip) & sight) << shift
                down |= ((seen[3] >> skip) & sight) << shift
                up |= ((seen[4] >> skip) & sight) << shift
            planes = rules.conflicting_cells((cell, right, left, down, up))
            for move in range(rules.MOVES):
                work.conflicting[t, word, move] = planes[move]


@inlined
def find_goal(work: Workspace, grid: Grid, agent: Agent, leg: int) -> VisibleGoal:
    """Find where the goal of a leg is in sight."""
    window, side = work.conflicting.shape[0], work.rows.shape[0]
    cell = grid.goals[agent.goal[leg]]
    row = rules.goal_row(cell, agent.position, grid.width, window)
    column = rules.goal_column(cell, agent.position, grid.width, window)
    if rules.ends_leg(leg, agent.service_time[leg]) and rules.is_visible(row, column, side):
        return VisibleGoal(row, column, work.rows[row, 0], 1 << (work.rows[row, 1] + column))
    return VisibleGoal(-1, -1, 0, 0)
