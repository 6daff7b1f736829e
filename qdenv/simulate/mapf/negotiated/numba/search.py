"""The best path of one agent through a window, past the reservations of the others.

The paths that `xla.search` finds, by A* over delays (Hart, Nilsson and Raphael 1968,
https://doi.org/10.1109/TSSC.1968.300136) instead of sets of cells: what a state costs at least
follows from the state alone, and never falls along a path. So states are visitd once, in the order
of their cost, until all those of the cheapest end are: these hold every best path, hence ties fall
as they do in XLA. Most searches end among the shortest ways without a conflict, a dozen states.

A state is a cell, at a time, on a leg, after some number of conflicts, and how long the agent has
served there. It is packed into one number.
"""

from typing import NamedTuple

import numpy as np

from qdenv.grid import NUM_MOVES, move_steps
from qdenv.native import Scalar, formula, kernel, shared
from qdenv.simulate.mapf.host.distances import INDICES, DistanceFields, distance
from qdenv.simulate.mapf.host.state import GridMap
from qdenv.simulate.mapf.negotiated import path_rules, rules
from qdenv.simulate.mapf.negotiated.numba.reservations import (
    ReservationWords,
    is_reserved,
    is_taken,
)

_NO_STATE = -1
_NOT_MEASURED = -1
# Where the parts of a state stand in its number.
PLACE_BIT, TIME_BIT, LEG_BIT, CONFLICTS_BIT, ELAPSED_BIT = 24, 34, 39, 40, 44
CELLS, PLACES, TIMES, LEGS, LEVELS = (1 << 24) - 1, (1 << 10) - 1, 31, 1, 15
_LEG_MARKS = 4  # marks of a leg: one per number of conflicts
_MARK_BITS = 2 * _LEG_MARKS


class Agent(NamedTuple):
    """The agent that plans."""

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
    num_states: Scalar  # int64 [], states so far
    top: Scalar  # int64 [], the largest cost among them
    search: Scalar  # int64 [], the number of this search
    between: Scalar  # int64 [], steps between the two goals, or `_NOT_MEASURED`
    steps: np.ndarray  # int64 [5], what each move adds to a place in sight
    side: int  # E
    levels: int  # L


def make_arrays(window: int, levels: int, dearest: int) -> SearchArrays:
    """Make the arrays of searches of `window` steps; a conflict costs `dearest` at most."""
    side = 2 * window + 1
    driving, serving = side * side, path_rules.SERVED_BITS + window
    states = (window + 1) * path_rules.LEGS * levels * (driving + serving)
    costs = _delays(window) + (levels - 1) * capped_penalty(dearest, window) + 1
    num_states, top, search, between = (np.zeros((), np.int64) for _ in range(4))
    return SearchArrays(
        np.zeros((window + 1, side * side), np.int64),
        np.zeros((levels, path_rules.LEGS, window + 1), np.int64),
        np.empty(states, np.int64),
        np.empty(states, np.int32),
        np.full(costs, _NO_STATE, np.int32),
        num_states,
        top,
        search,
        between,
        move_steps(side),
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
def _pack(cell: int, place: int, t: int, leg: int, conflicts: int) -> int:
    """Number a driving state; `search` adds how long the agent has served."""
    legs = (leg << LEG_BIT) | (conflicts << CONFLICTS_BIT)
    return cell | (place << PLACE_BIT) | (t << TIME_BIT) | legs


@formula
def _unpack(state: int) -> tuple[int, int, int, int, int]:
    """Read cell, place, time, leg and conflicts of a state."""
    cell, place, t = state & CELLS, (state >> PLACE_BIT) & PLACES, (state >> TIME_BIT) & TIMES
    return cell, place, t, (state >> LEG_BIT) & LEGS, (state >> CONFLICTS_BIT) & LEVELS


@formula
def _enqueue(work: SearchArrays, state: int, cost: int) -> None:
    """Queue a state by its cost."""
    cost = _in_range(work, cost)
    link(work, work.num_states[()], state, cost)
    work.num_states[()] += 1
    work.top[()] = max(work.top[()], cost)


@formula
def _in_range(work: SearchArrays, cost: int) -> int:
    """Bound a cost: full fields of distances give costs out of range."""
    return min(max(cost, 0), work.first.size - 1)


@formula
def link(work: SearchArrays, index: int, state: int, cost: int) -> None:
    """Put a state, the `index`-th of the search, before all others that cost as much."""
    work.state[index], work.later[index] = state, work.first[cost]
    work.first[cost] = index


@formula
def mark(work: SearchArrays, search: int, t: int, place: int, leg: int, conflicts: int) -> bool:
    """Mark that paths go on from a place in this search; returns True if that is new."""
    marks = work.mark[t, place]
    if marks >> _MARK_BITS != search:
        marks = search << _MARK_BITS
    bit = 1 << (leg * _LEG_MARKS + conflicts)
    work.mark[t, place] = marks | bit
    return (marks & bit) == 0


@formula
def is_marked(work: SearchArrays, t: int, place: int, leg: int, conflicts: int) -> int:
    """Return whether paths go on from a place (0 or 1)."""
    marks = work.mark[t, place]
    known = marks >> _MARK_BITS == work.search[()]
    return (marks >> (leg * _LEG_MARKS + conflicts)) & known


@kernel
def find_path(
    work: SearchArrays,
    reservations: ReservationWords,
    fields: DistanceFields,
    grid: GridMap,
    agent: Agent,
) -> int:
    """Find the best path of one agent; returns the code of its end, or -1 where there is none."""
    work.num_states[()], work.top[()], work.between[()] = 0, 0, _NOT_MEASURED
    work.search[()] += 1
    for conflicts in range(work.levels):
        for leg in range(path_rules.LEGS):
            for t in range(work.served.shape[2]):
                work.served[conflicts, leg, t] = 0
    least = _start(work, fields, grid, agent)
    best, cost, dearest = path_rules.INFEASIBLE, 0, work.first.size
    while cost <= work.top[()]:
        index = work.first[cost]
        if index == _NO_STATE:
            if best < path_rules.INFEASIBLE:
                break  # all of its cost were visitd
            cost += 1
            continue
        index &= INDICES
        work.first[cost] = work.later[index]
        state = work.state[index]
        if (state >> TIME_BIT) & TIMES == work.mark.shape[0] - 1:
            best = min(best, _end_code(work, state) ^ path_rules.tie_breaker(agent.tie_break))
            dearest = cost
        elif state >> ELAPSED_BIT:
            _serve_on(work, reservations, fields, grid, agent, state, least)
        else:
            _drive_on(work, reservations, fields, grid, agent, state, least, dearest)
    # From 0 on: where the fields are full costs mean nothing, and states may wait below this one.
    for other in range(work.top[()] + 1):
        work.first[other] = _NO_STATE
    found = best < path_rules.INFEASIBLE
    return best ^ path_rules.tie_breaker(agent.tie_break) if found else -1


@formula
def _start(work: SearchArrays, fields: DistanceFields, grid: GridMap, agent: Agent) -> int:
    """Queue the first state; returns the least possible cost."""
    middle = work.side * work.side // 2
    if agent.remaining_service:
        elapsed = agent.service_time[0] - agent.remaining_service
        state = _pack(agent.position, middle, 0, 0, 0)
        work.served[0, 0, 0] = 1 << elapsed
        _enqueue(work, state | ((elapsed + 1) << ELAPSED_BIT), 0)
        return path_rules.COST_UNIT * agent.remaining_service
    # Standing on the goal is not arriving: the path leaves it like any other cell.
    mark(work, work.search[()], 0, middle, 0, 0)
    _enqueue(work, _pack(agent.position, middle, 0, 0, 0), 0)
    left = distance(fields, grid, agent.goal[0], agent.position) + agent.service_time[0]
    return path_rules.COST_UNIT * left


@formula
def _left(
    work: SearchArrays, fields: DistanceFields, grid: GridMap, agent: Agent, leg: int, cell: int
) -> int:
    """Count the timesteps left from a cell until the current goal is done, less than 0 beyond."""
    if leg == 0:
        return distance(fields, grid, agent.goal[0], cell) + agent.service_time[0]
    if work.between[()] == _NOT_MEASURED:
        work.between[()] = distance(fields, grid, agent.goal[1], agent.cell[0])
    return distance(fields, grid, agent.goal[1], cell) - work.between[()]


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
    search, states, top = work.search[()], work.num_states[()], work.top[()]
    # Waiting always costs a timestep more: once the best cost is known, nobody does.
    for move in range(dearest < work.first.size, NUM_MOVES):
        other = (cell + grid.steps[move]) & CELLS
        word = reservations.word[other]
        if word < 0:
            continue
        after = min(conflicts + is_taken(word, t, move), work.levels - 1)
        there = (place + work.steps[move]) & PLACES
        if other == goal:
            work.num_states[()], work.top[()] = states, top
            _serve(work, fields, grid, agent, _pack(other, there, t + 1, leg, after), 0, least)
            states, top = work.num_states[()], work.top[()]
        elif mark(work, search, t + 1, there, leg, after):
            left = t + 1 + _left(work, fields, grid, agent, leg, other)
            cost = _in_range(work, path_rules.COST_UNIT * left + after * agent.penalty - least)
            if cost <= dearest:
                link(work, states, _pack(other, there, t + 1, leg, after), cost)
                states, top = states + 1, max(top, cost)
    work.num_states[()], work.top[()] = states, top


@kernel
def _serve_on(
    work: SearchArrays,
    reservations: ReservationWords,
    fields: DistanceFields,
    grid: GridMap,
    agent: Agent,
    state: int,
    least: int,
) -> None:
    """Visit a serving state: serve for one timestep more."""
    cell, place, t, leg, conflicts = _unpack(state)
    after = min(conflicts + is_reserved(reservations.word[cell], t), work.levels - 1)
    elapsed = state >> ELAPSED_BIT
    _serve(work, fields, grid, agent, _pack(cell, place, t + 1, leg, after), elapsed, least)


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
    still = max(agent.service_time[leg] - elapsed, 0)
    # Counted from the goal on: a leg's service is part of what is left on the way to it.
    left = still
    if leg == 1:
        left += _left(work, fields, grid, agent, 1, cell) - agent.service_time[1]
    price = conflicts * agent.penalty - least
    cost = path_rules.COST_UNIT * (t + left) + price
    _enqueue(work, state | ((elapsed + 1) << ELAPSED_BIT), cost)
    if leg == 0 and elapsed == agent.service_time[0]:
        if not mark(work, work.search[()], t, place, 1, conflicts):
            return
        left = _left(work, fields, grid, agent, 1, cell)
        cost = path_rules.COST_UNIT * (t + left) + price
        _enqueue(work, _pack(cell, place, t, 1, conflicts), cost)


@kernel
def _end_code(work: SearchArrays, state: int) -> int:
    """Give the end of a path its code."""
    _, place, _, leg, conflicts = _unpack(state)
    served = state >> ELAPSED_BIT
    if served:
        return path_rules.serving_end(leg, conflicts, work.levels, served - 1, work.side)
    row, column = place // work.side, place % work.side
    return path_rules.driving_end(leg, conflicts, work.levels, row, column, work.side)
