"""The best path of one agent through a window past the reservations of the others, and these.

The paths that `xla.search` finds, by A* over delays (Hart, Nilsson and Raphael 1968,
https://doi.org/10.1109/TSSC.1968.300136) instead of sets of cells: what a state costs at least
follows from the state alone, and never falls along a path. So states are visited once, in the order
of their cost, until all those of the cheapest end are: these hold every best path, hence ties fall
as they do in XLA. Most searches end among the shortest ways without a conflict, a dozen states.

A state is a cell, at a time, on a leg, after some number of conflicts, and how long the agent has
served there. It is packed into one number.
"""

from typing import NamedTuple

import numpy as np

from qdenv.grid import DOWN, LEFT, NUM_MOVES, RIGHT, UP, WAIT, move_steps
from qdenv.native import Numbers, formula, kernel, numbers
from qdenv.simulate.mapf.host.distances import INDICES, DistanceFields, distance
from qdenv.simulate.mapf.host.state import GridMap
from qdenv.simulate.mapf.negotiated import rules

_NO_STATE = -1
_NOT_MEASURED = -1
# Where the parts of a state stand in its number.
_PLACE_BIT, _TIME_BIT, _LEG_BIT, _CONFLICTS_BIT, _ELAPSED_BIT = 24, 34, 39, 40, 44
_CELLS, _PLACES, _TIMES, _LEGS, _LEVELS = (1 << 24) - 1, (1 << 10) - 1, 31, 1, 15
_LEG_MARKS = 4  # marks of a leg: one per number of conflicts
_MARK_BITS = 2 * _LEG_MARKS

PLANE = 12  # bits of a plane: a window of at most ten steps, and five planes below the sign
WALL = -1 << 63  # the sign: a wall
# Where in a word those stand who leave against each move; waiting has none but itself.
AGAINST = PLANE * np.array([WAIT, LEFT, RIGHT, UP, DOWN])


class ReservationWords(NamedTuple):
    """What each agent has reserved in a window of w steps; A agents, N cells.

    One word per cell holds all its reservations: plane p at timestep t is bit ``PLANE * p + t``,
    with the planes of `xla`. So a search reads one word per step. Reserved paths never conflict,
    hence every bit has one owner and is set and cleared by flipping it.
    """

    word: np.ndarray  # int64 [N], the planes of every cell, and `WALL`
    # int32 [N, w + 1], the last agent to reserve a cell at a time; holds it as long as the bits
    # say so
    owner: np.ndarray
    path: np.ndarray  # int64 [A, w + 1], the latest path of every agent
    steps: np.ndarray  # int64 [A], steps of that path that are reserved


@formula
def is_taken(word: int, t: int, move: int) -> int:
    """Return whether arriving in a cell by a move, from t to t + 1, conflicts (0 or 1)."""
    here = word >> t
    # An agent that leaves the cell against the move would be swapped with.
    return (here | (here >> AGAINST[move])) & 1


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


class Agent(NamedTuple):
    """The agent that plans."""

    number: int
    position: int  # cell of the padded grid
    goal: tuple[int, int]  # slots of the current and of the next goal
    cell: tuple[int, int]  # their cells
    service_time: tuple[int, int]  # timesteps to serve at each
    remaining_service: int  # timesteps still to serve where the agent is; 0 while driving
    penalty: int  # cost of a conflict
    tie_break: int  # random bits that settle ties


class SearchArrays(NamedTuple):
    """The arrays of one search; w steps, L conflict levels, a square of E x E cells in sight."""

    # int64 [w + 1, E * E], the number of the last search that reached a cell at a time, and below
    # it one bit per leg and number of conflicts
    mark: np.ndarray
    served: np.ndarray  # int64 [L, 2, w + 1], bit e: a path has served for e timesteps
    state: np.ndarray  # int64 [states], as `_pack` makes them
    later: np.ndarray  # int32 [states], the next state that costs as much
    first: np.ndarray  # int32 [costs], the first state of each cost above the least possible one
    # states, how many there are; top, the largest cost among them; search, the number of this
    # search; between, steps between the two goals, or `_NOT_MEASURED`
    numbers: Numbers
    steps: np.ndarray  # int64 [5], what each move adds to a place in sight
    penalties: np.ndarray  # int64 [attempts], cost of driving over one reservation
    side: int  # E
    levels: int  # L


def make_arrays(window: int, levels: int, penalties: np.ndarray) -> SearchArrays:
    """Make the arrays of searches of `window` steps with these costs (int [attempts])."""
    side = 2 * window + 1
    driving, serving = side * side, rules.SERVED_BITS + window
    states = (window + 1) * rules.LEGS * levels * (driving + serving)
    # The most that a path can lose: two steps of distance with every step away. Above what any way
    # round can cost, a larger penalty makes no difference.
    delays = 2 * rules.COST_UNIT * (window + 1)
    penalties = np.minimum(penalties, delays + 1).astype(np.int64)
    costs = delays + (levels - 1) * int(penalties.max()) + 1
    return SearchArrays(
        np.zeros((window + 1, side * side), np.int64),
        np.zeros((levels, rules.LEGS, window + 1), np.int64),
        np.empty(states, np.int64),
        np.empty(states, np.int32),
        np.full(costs, _NO_STATE, np.int32),
        numbers("states", "top", "search", "between"),
        move_steps(side),
        penalties,
        side,
        levels,
    )


@formula
def _pack(cell: int, place: int, t: int, leg: int, conflicts: int) -> int:
    """Number a driving state; how long the agent has served is added above."""
    legs = (leg << _LEG_BIT) | (conflicts << _CONFLICTS_BIT)
    return cell | (place << _PLACE_BIT) | (t << _TIME_BIT) | legs


@formula
def _unpack(state: int) -> tuple[int, int, int, int, int]:
    """Read cell, place, time, leg and conflicts of a state."""
    cell, place, t = state & _CELLS, (state >> _PLACE_BIT) & _PLACES, (state >> _TIME_BIT) & _TIMES
    return cell, place, t, (state >> _LEG_BIT) & _LEGS, (state >> _CONFLICTS_BIT) & _LEVELS


@formula
def _link(work: SearchArrays, index: int, state: int, cost: int) -> int:
    """Put a state, the `index`-th of the search, before all others that cost as much.

    Returns the cost; it is bounded, for full fields of distances give costs out of range.
    """
    cost = min(max(cost, 0), work.first.size - 1)
    work.state[index], work.later[index] = state, work.first[cost]
    work.first[cost] = index
    return cost


@formula
def _enqueue(work: SearchArrays, state: int, cost: int) -> None:
    """Queue a state by its cost."""
    cost = _link(work, work.numbers.states, state, cost)
    work.numbers.states += 1
    work.numbers.top = max(work.numbers.top, cost)


@formula
def _mark(work: SearchArrays, search: int, t: int, place: int, leg: int, conflicts: int) -> bool:
    """Mark that paths go on from a place in this search; returns True if that is new."""
    marks = work.mark[t, place]
    if marks >> _MARK_BITS != search:
        marks = search << _MARK_BITS
    bit = 1 << (leg * _LEG_MARKS + conflicts)
    work.mark[t, place] = marks | bit
    return (marks & bit) == 0


@kernel
def find_path(
    work: SearchArrays,
    reservations: ReservationWords,
    fields: DistanceFields,
    grid: GridMap,
    agent: Agent,
) -> bool:
    """Find the best path of one agent, into ``reservations.path``; False if there is none."""
    counts, window = work.numbers, work.mark.shape[0] - 1
    counts.states, counts.top, counts.between = 0, 0, _NOT_MEASURED
    counts.search += 1
    work.served[:] = 0
    least = _start(work, fields, grid, agent)
    best, cost, dearest = rules.INFEASIBLE, 0, work.first.size
    while cost <= counts.top:
        index = work.first[cost]
        if index == _NO_STATE:
            if best < rules.INFEASIBLE:
                break  # all of its cost were visited
            cost += 1
            continue
        index &= INDICES
        work.first[cost] = work.later[index]
        state = work.state[index]
        cell, place, t, leg, conflicts = _unpack(state)
        served = state >> _ELAPSED_BIT
        if t == window:
            if served:
                end = rules.serving_end(leg, conflicts, work.levels, served - 1, work.side)
            else:
                row, column = place // work.side, place % work.side
                end = rules.driving_end(leg, conflicts, work.levels, row, column, work.side)
            best = min(best, end ^ (agent.tie_break & rules.CODES))
            dearest = cost
        elif served:
            disturbed = (reservations.word[cell] >> t) & 1
            after = min(conflicts + disturbed, work.levels - 1)
            later = _pack(cell, place, t + 1, leg, after)
            _serve(work, fields, grid, agent, later, served, least)
        else:
            _drive_on(work, reservations, fields, grid, agent, state, least, dearest)
    # From 0 on: where the fields are full costs mean nothing, and states may wait below this one.
    for other in range(counts.top + 1):
        work.first[other] = _NO_STATE
    if best == rules.INFEASIBLE:
        return False
    _trace(work, reservations, grid, agent, best ^ (agent.tie_break & rules.CODES))
    return True


@formula
def _start(work: SearchArrays, fields: DistanceFields, grid: GridMap, agent: Agent) -> int:
    """Queue the first state; returns the least possible cost."""
    middle = work.side * work.side // 2
    state = _pack(agent.position, middle, 0, 0, 0)
    if agent.remaining_service:
        elapsed = agent.service_time[0] - agent.remaining_service
        work.served[0, 0, 0] = 1 << elapsed
        _enqueue(work, state | ((elapsed + 1) << _ELAPSED_BIT), 0)
        return rules.COST_UNIT * agent.remaining_service
    # Standing on the goal is not arriving: the path leaves it like any other cell.
    _mark(work, work.numbers.search, 0, middle, 0, 0)
    _enqueue(work, state, 0)
    left = distance(fields, grid, agent.goal[0], agent.position) + agent.service_time[0]
    return rules.COST_UNIT * left


@formula
def _left(
    work: SearchArrays, fields: DistanceFields, grid: GridMap, agent: Agent, leg: int, cell: int
) -> int:
    """Count the timesteps left from a cell until the current goal is done, less than 0 beyond."""
    if leg == 0:
        return distance(fields, grid, agent.goal[0], cell) + agent.service_time[0]
    if work.numbers.between == _NOT_MEASURED:
        work.numbers.between = distance(fields, grid, agent.goal[1], agent.cell[0])
    return distance(fields, grid, agent.goal[1], cell) - work.numbers.between


@formula
def _drive_on(
    work: SearchArrays,
    reservations: ReservationWords,
    fields: DistanceFields,
    grid: GridMap,
    agent: Agent,
    state: int,
    least: int,
    dearest: int,
) -> None:
    """Visit a driving state: queue what one step leads to, if it costs no more than `dearest`.

    Half of a run's time is spent here: what the loop counts stays in registers, for the compiler
    must expect any array to overlap any other.
    """
    cell, place, t, leg, conflicts = _unpack(state)
    goal = agent.cell[leg] if rules.ends_leg(leg, agent.service_time[leg]) else -1
    search, states, top = work.numbers.search, work.numbers.states, work.numbers.top
    # Waiting always costs a timestep more: once the best cost is known, nobody does.
    for move in range(dearest < work.first.size, NUM_MOVES):
        # Masked, as an index is known not to count from the end.
        other = (cell + grid.steps[move]) & _CELLS
        word = reservations.word[other]
        if word < 0:
            continue
        after = min(conflicts + is_taken(word, t, move), work.levels - 1)
        there = (place + work.steps[move]) & _PLACES
        if other == goal:
            work.numbers.states, work.numbers.top = states, top
            _serve(work, fields, grid, agent, _pack(other, there, t + 1, leg, after), 0, least)
            states, top = work.numbers.states, work.numbers.top
        elif _mark(work, search, t + 1, there, leg, after):
            left = t + 1 + _left(work, fields, grid, agent, leg, other)
            cost = rules.COST_UNIT * left + after * agent.penalty - least
            if cost <= dearest:
                cost = _link(work, states, _pack(other, there, t + 1, leg, after), cost)
                states, top = states + 1, max(top, cost)
    work.numbers.states, work.numbers.top = states, top


@kernel
def _serve(
    work: SearchArrays,
    fields: DistanceFields,
    grid: GridMap,
    agent: Agent,
    state: int,
    elapsed: int,
    least: int,
) -> None:
    """Queue that the agent has served for `elapsed` timesteps, and may go on to the next goal."""
    cell, place, t, leg, conflicts = _unpack(state)
    if (work.served[conflicts, leg, t] >> elapsed) & 1:
        return
    work.served[conflicts, leg, t] |= 1 << elapsed
    # Counted from the goal on: a leg's service is part of what is left on the way to it.
    left = max(agent.service_time[leg] - elapsed, 0)
    if leg == 1:
        left += _left(work, fields, grid, agent, 1, cell) - agent.service_time[1]
    price = conflicts * agent.penalty - least
    cost = rules.COST_UNIT * (t + left) + price
    _enqueue(work, state | ((elapsed + 1) << _ELAPSED_BIT), cost)
    if leg == 0 and elapsed == agent.service_time[0]:
        if not _mark(work, work.numbers.search, t, place, 1, conflicts):
            return
        left = _left(work, fields, grid, agent, 1, cell)
        cost = rules.COST_UNIT * (t + left) + price
        _enqueue(work, _pack(cell, place, t, 1, conflicts), cost)


@kernel
def _trace(
    work: SearchArrays, reservations: ReservationWords, grid: GridMap, agent: Agent, end: int
) -> None:
    """Read the path with this end backwards out of what the search visited."""
    path, middle, search = reservations.path, work.side // 2, work.numbers.search
    flipped = (agent.tie_break >> rules.CODE_BITS) & 1
    leg, conflicts, row, column, elapsed = rules.unpack_end(end, work.levels, work.side)
    if elapsed >= 0:  # in service: at the goal
        row, column = rules.find_in_window(agent.cell[leg], agent.position, grid.width, middle)
    for t in range(path.shape[1] - 1, 0, -1):
        cell = agent.position + (row - middle) * grid.width + column - middle
        path[agent.number, t] = cell
        # Leg 1 began where the service at the current goal ended.
        finished = (work.served[conflicts, 0, t] >> agent.service_time[0]) & 1
        if elapsed < 0 and leg == 1 and cell == agent.cell[0] and finished:
            leg, elapsed = 0, agent.service_time[0]
        word = reservations.word[cell] >> (t - 1)
        if elapsed > 0:
            fewer = (work.served[max(conflicts - 1, 0), leg, t - 1] >> (elapsed - 1)) & 1
            conflicts -= rules.service_conflict(conflicts, word & 1, fewer)
            elapsed -= 1
            continue
        # The first neighbour, in order of preference, from which this cell was reached.
        elapsed = -1
        for rank in range(NUM_MOVES):
            move = rules.move_at(rank, flipped)
            i, j = rules.cell_before(row, column, move)
            if not (0 <= i < work.side and 0 <= j < work.side):
                continue
            marks, bit = work.mark[t - 1, i * work.side + j], leg * _LEG_MARKS + conflicts
            reached = marks >> _MARK_BITS == search
            same = (marks >> bit) & reached
            fewer = (marks >> (bit - 1)) & reached if conflicts else 0
            conflicting = is_taken(word, 0, move)
            last = conflicts == work.levels - 1
            if rules.is_predecessor(same, fewer, conflicting, last):
                conflicts, row, column = conflicts - (conflicting & fewer), i, j
                break
    path[agent.number, 0] = agent.position
