"""The states of a search, queued by what they cost, marked once reached.

A state is a cell, at a time, on a leg, after so many conflicts, and how long it has served there.
It is packed into one number.
"""

from typing import NamedTuple

import numpy as np

from qdenv.native import formula, shared
from qdenv.simulate.mapf.negotiated import path_rules

NO_STATE = -1
STATES, TOP, SEARCH, BETWEEN = range(4)  # entries of `Workspace.number`
NOT_MEASURED = -1
# Where the parts of a state stand in its number.
PLACE_BIT, TIME_BIT, LEG_BIT, CONFLICTS_BIT, ELAPSED_BIT = 24, 34, 39, 40, 44
CELLS, PLACES, TIMES, LEGS, LEVELS = (1 << 24) - 1, (1 << 10) - 1, 31, 1, 15
LEG_MARKS = 4  # marks of a leg: one per number of conflicts
MARK_BITS = 2 * LEG_MARKS


class Agent(NamedTuple):
    """Who plans."""

    position: int  # cell of the padded grid
    goal: tuple[int, int]  # slots of the current and of the next goal
    cell: tuple[int, int]  # their cells
    service_time: tuple[int, int]  # timesteps to serve at each
    remaining_service: int  # timesteps still to serve where the agent is; 0 while driving
    penalty: int  # cost of a conflict
    noise: int  # random bits that settle ties


class Workspace(NamedTuple):
    """The arrays of one search; w steps, L conflict levels, a square of E x E cells in sight."""

    # int64 [w + 1, E * E], the number of the last search that reached a cell at a time, and below
    # it one bit per leg and number of conflicts
    mark: np.ndarray
    served: np.ndarray  # int64 [L, 2, w + 1], bit e: a path has served for e timesteps
    state: np.ndarray  # int64 [states], as `pack` makes them
    later: np.ndarray  # int32 [states], the next state that costs as much
    first: np.ndarray  # int32 [costs], the first state of each cost above the least possible one
    # int64 [4], states so far, the largest cost among them, searches so far, and the distance
    # between the two goals
    number: np.ndarray
    steps: np.ndarray  # int64 [5], what each move adds to a place in sight
    side: int  # E
    levels: int  # L


def make_workspace(window: int, levels: int, dearest: int) -> Workspace:
    """Make room for searches of `window` steps in which a conflict costs `dearest` at most."""
    side = 2 * window + 1
    driving, serving = side * side, path_rules.SERVED_BITS + window
    states = (window + 1) * path_rules.LEGS * levels * (driving + serving)
    costs = _delays(window) + (levels - 1) * capped_penalty(dearest, window) + 1
    return Workspace(
        np.zeros((window + 1, side * side), np.int64),
        np.zeros((levels, path_rules.LEGS, window + 1), np.int64),
        np.empty(states, np.int64),
        np.empty(states, np.int32),
        np.full(costs, NO_STATE, np.int32),
        np.zeros(4, np.int64),
        np.array([0, 1, -1, side, -side]),
        side,
        levels,
    )


@shared
def _delays(window: int) -> int:
    """Find the most that a path can lose: two steps of distance with every step away."""
    return 2 * path_rules.COST_UNIT * (window + 1)


@shared
def capped_penalty(penalty: int, window: int) -> int:
    """Cap the cost of a conflict: above what any way round can cost, more makes no difference."""
    return min(penalty, _delays(window) + 1)


@formula
def pack(cell: int, place: int, t: int, leg: int, conflicts: int) -> int:
    """Number a driving state; `search` adds how long one has served."""
    legs = (leg << LEG_BIT) | (conflicts << CONFLICTS_BIT)
    return cell | (place << PLACE_BIT) | (t << TIME_BIT) | legs


@formula
def unpack(state: int) -> tuple[int, int, int, int, int]:
    """Read cell, place, time, leg and conflicts of a state."""
    cell, place, t = state & CELLS, (state >> PLACE_BIT) & PLACES, (state >> TIME_BIT) & TIMES
    return cell, place, t, (state >> LEG_BIT) & LEGS, (state >> CONFLICTS_BIT) & LEVELS


@formula
def enqueue(work: Workspace, state: int, cost: int) -> None:
    """Queue a state by its cost."""
    cost = in_range(work, cost)
    link(work, work.number[STATES], state, cost)
    work.number[STATES] += 1
    work.number[TOP] = max(work.number[TOP], cost)


@formula
def in_range(work: Workspace, cost: int) -> int:
    """Bound a cost: one out of range is none, as fields that lack room give."""
    return min(max(cost, 0), work.first.size - 1)


@formula
def link(work: Workspace, index: int, state: int, cost: int) -> None:
    """Put a state, the `index`-th of the search, before all others that cost as much."""
    work.state[index], work.later[index] = state, work.first[cost]
    work.first[cost] = index


@formula
def mark(work: Workspace, search: int, t: int, place: int, leg: int, conflicts: int) -> bool:
    """Mark that paths go on from a place in this search; returns whether that is new."""
    marks = work.mark[t, place]
    if marks >> MARK_BITS != search:
        marks = search << MARK_BITS
    bit = 1 << (leg * LEG_MARKS + conflicts)
    work.mark[t, place] = marks | bit
    return (marks & bit) == 0


@formula
def is_marked(work: Workspace, t: int, place: int, leg: int, conflicts: int) -> int:
    """Tell whether paths go on from a place (0 or 1)."""
    marks = work.mark[t, place]
    known = marks >> MARK_BITS == work.number[SEARCH]
    return (marks >> (leg * LEG_MARKS + conflicts)) & known
