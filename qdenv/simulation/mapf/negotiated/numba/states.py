"""The states of a search: what is remembered of each, and the queue in which they wait.

A state is a cell, at a time, on a leg, after some number of conflicts, and how long the agent has
served there. It is packed into one number. Without costs of moves all paths to a state cost the
same, its time. With costs a state may be reached at less cost later; then it is queued again, and
further visits of it change nothing.
"""

from typing import NamedTuple

import numpy as np

from qdenv.grid import NUM_MOVES, move_steps
from qdenv.native import Numbers, formula, numbers
from qdenv.simulation.mapf.host.distances import BUCKETS
from qdenv.simulation.mapf.negotiated import rules
from qdenv.simulation.mapf.negotiated.settings import COST_UNIT

NO_STATE = -1
NOT_MEASURED = -1
# Where the parts of a state stand in its number.
_PLACE_BIT, _TIME_BIT, _LEG_BIT, _CONFLICTS_BIT, ELAPSED_BIT = 24, 34, 39, 40, 44
CELLS, PLACES, _TIMES, _LEGS, _LEVELS = (1 << 24) - 1, (1 << 10) - 1, 31, 1, 15
LEG_MARKS = 4  # marks of a leg: one per number of conflicts
_MARK_BITS = 2 * LEG_MARKS


class SearchArrays(NamedTuple):
    """The arrays of one search; w steps, L conflict levels, a square of E x E cells in sight."""

    # int64 [w + 1, E * E], the number of the last search that reached a cell at a time, and below
    # it one bit per leg and number of conflicts
    mark: np.ndarray
    served: np.ndarray  # int64 [L, 2, w + 1], bit e: a path has served for e timesteps
    state: np.ndarray  # int64 [states], as `pack` makes them
    later: np.ndarray  # int32 [states], the next state that costs as much
    first: np.ndarray  # int32 [costs], the first state of each cost above the least possible one
    # states, how many there are; top, the largest cost among them; search, the number of this
    # search; between, steps between the two goals, or `NOT_MEASURED`
    numbers: Numbers
    steps: np.ndarray  # int64 [5], what each move adds to a place in sight
    penalties: np.ndarray  # int64 [attempts], cost of driving over one reservation
    side: int  # E
    levels: int  # L
    # Where moves have costs, else empty: int32 [w + 1, E * E, marks], the least cost of a path that
    # goes on from a place; int32 [L, 2, w + 1, elapsed], and of one in service.
    spent: np.ndarray
    spent_serving: np.ndarray
    # One entry where moves have costs, else empty: its length is known when kernels are compiled,
    # so that costs which are not there cost no time.
    guided: tuple[int, ...]


def make_arrays(window: int, levels: int, penalties: np.ndarray, has_costs: bool) -> SearchArrays:
    """Make the arrays of searches of `window` steps with these costs (int [attempts]).

    `has_costs` if moves have costs, too.
    """
    side = 2 * window + 1
    driving, serving = side * side, rules.SERVED_BITS + window
    states = (window + 1) * rules.LEGS * levels * (driving + serving)
    if has_costs:
        # What it costs at most to stand still: no best path costs more, so those that do may share
        # the last number. Each move to a state can find a cheaper way to it.
        delays, states = BUCKETS * (window + 1), (NUM_MOVES + 1) * states
        spent, serving_times = (window + 1, side * side, _MARK_BITS), rules.SERVED_BITS
    else:
        # The most that a path can lose: two steps of distance with every step away. Above what any
        # way round can cost, a larger penalty makes no difference.
        delays = 2 * COST_UNIT * (window + 1)
        penalties = np.minimum(penalties, delays + 1)
        spent, serving_times = (0, 0, 0), 0
    penalties = penalties.astype(np.int64)
    costs = delays + (levels - 1) * int(penalties.max()) + 1
    return SearchArrays(
        np.zeros((window + 1, side * side), np.int64),
        np.zeros((levels, rules.LEGS, window + 1), np.int64),
        np.empty(states, np.int64),
        np.empty(states, np.int32),
        np.full(costs, NO_STATE, np.int32),
        numbers("states", "top", "search", "between"),
        move_steps(side),
        penalties,
        side,
        levels,
        np.zeros(spent, np.int32),
        np.zeros((levels, rules.LEGS, window + 1, serving_times), np.int32),
        (1,) * has_costs,
    )


@formula
def cost_units(work: SearchArrays) -> tuple[int, int]:
    """Return the costs of a timestep of service, and of a unit of distance."""
    return rules.units(len(work.guided))


@formula
def pack(cell: int, place: int, t: int, leg: int, conflicts: int) -> int:
    """Number a driving state; how long the agent has served is added above."""
    legs = (leg << _LEG_BIT) | (conflicts << _CONFLICTS_BIT)
    return cell | (place << _PLACE_BIT) | (t << _TIME_BIT) | legs


@formula
def unpack(state: int) -> tuple[int, int, int, int, int]:
    """Read cell, place, time, leg and conflicts of a state."""
    cell, place, t = state & CELLS, (state >> _PLACE_BIT) & PLACES, (state >> _TIME_BIT) & _TIMES
    return cell, place, t, (state >> _LEG_BIT) & _LEGS, (state >> _CONFLICTS_BIT) & _LEVELS


@formula
def link(work: SearchArrays, index: int, state: int, cost: int) -> int:
    """Put a state, the `index`-th of the search, before all others that cost as much.

    Returns the cost; it is bounded, for full fields of distances give costs out of range.
    """
    cost = min(max(cost, 0), work.first.size - 1)
    work.state[index], work.later[index] = state, work.first[cost]
    work.first[cost] = index
    return cost


@formula
def enqueue(work: SearchArrays, state: int, cost: int) -> None:
    """Queue a state by its cost."""
    cost = link(work, work.numbers.states, state, cost)
    work.numbers.states += 1
    work.numbers.top = max(work.numbers.top, cost)


@formula
def mark(
    work: SearchArrays, search: int, t: int, place: int, leg: int, conflicts: int, spent: int
) -> bool:
    """Mark that a path goes on from a place in this search; returns True if none cost as little."""
    marks = work.mark[t, place]
    if marks >> _MARK_BITS != search:
        marks = search << _MARK_BITS
    bit = 1 << (leg * LEG_MARKS + conflicts)
    work.mark[t, place] = marks | bit
    is_new = (marks & bit) == 0
    if len(work.guided) > 0:
        number = leg * LEG_MARKS + conflicts
        is_new = is_new or spent < work.spent[t, place, number]
        if is_new:
            work.spent[t, place, number] = spent
    return is_new


@formula
def is_marked(work: SearchArrays, t: int, place: int, number: int, spent: int) -> int:
    """Return whether a path that has cost `spent` goes on from a place (0 or 1)."""
    marks = work.mark[t, place]
    is_marked = (marks >> number) & (marks >> _MARK_BITS == work.numbers.search)
    if len(work.guided) > 0:
        is_marked &= work.spent[t, place, number] == spent
    return is_marked


@formula
def has_served(
    work: SearchArrays, conflicts: int, leg: int, t: int, elapsed: int, spent: int
) -> int:
    """Return whether a path that has cost `spent` has served for `elapsed` timesteps (0 or 1)."""
    served = (work.served[conflicts, leg, t] >> elapsed) & 1
    if len(work.guided) > 0:
        served &= work.spent_serving[conflicts, leg, t, elapsed] == spent
    return served


@formula
def spent_on(work: SearchArrays, t: int, place: int, leg: int, conflicts: int, elapsed: int) -> int:
    """Return the cost of the cheapest path to a state; `elapsed` is -1 while driving."""
    spent = COST_UNIT * t
    if len(work.guided) > 0:
        if elapsed >= 0:
            spent = work.spent_serving[conflicts, leg, t, elapsed] + 0  # as a number of 64 bits
        else:
            spent = work.spent[t, place, leg * LEG_MARKS + conflicts] + 0
    return spent
