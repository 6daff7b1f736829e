"""The best path of one agent through a window past the reservations of the others, and these.

The paths that `xla.search` finds, by A* over delays (Hart, Nilsson and Raphael 1968,
https://doi.org/10.1109/TSSC.1968.300136) instead of sets of cells: what a state costs at least
follows from the state alone, and never falls along a path. So states are visited once, in the order
of their cost, until all those of the cheapest end are: these hold every best path, hence ties fall
as they do in XLA. Most searches end among the shortest ways without a conflict, a dozen states.
"""

from typing import NamedTuple

import numpy as np

from qdenv.grid import DOWN, LEFT, NUM_MOVES, RIGHT, UP, WAIT
from qdenv.native import formula, kernel
from qdenv.simulation.mapf.host.distances import INDICES, DistanceFields, distance
from qdenv.simulation.mapf.host.state import GridMap
from qdenv.simulation.mapf.negotiated import rules
from qdenv.simulation.mapf.negotiated.numba.states import (
    CELLS,
    ELAPSED_BIT,
    LEG_MARKS,
    NO_STATE,
    NOT_MEASURED,
    PLACES,
    SearchArrays,
    cost_units,
    enqueue,
    has_served,
    is_marked,
    link,
    mark,
    pack,
    spent_on,
    unpack,
)
from qdenv.simulation.mapf.negotiated.settings import COST_UNIT
from qdenv.simulation.mapf.planner import move_of

PLANE = 12  # bits of a plane: a window of at most ten steps, and five planes below the sign
WALL = -1 << 63  # the sign: a wall
# First bit of the plane of agents that leave against each move; for waiting its own.
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
        plane = move_of(after - before, width)
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
    leg: int = 0  # on which it sets out


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
    counts.states, counts.top, counts.between = 0, 0, NOT_MEASURED
    counts.search += 1
    work.served[:] = 0
    least = _start(work, fields, grid, agent)
    best, cost, dearest = rules.INFEASIBLE, 0, work.first.size
    while cost <= counts.top and not fields.numbers.is_full:
        index = work.first[cost]
        if index == NO_STATE:
            if best < rules.INFEASIBLE:
                break  # all of its cost were visited
            cost += 1
            continue
        index &= INDICES
        work.first[cost] = work.later[index]
        state = work.state[index]
        cell, place, t, leg, conflicts = unpack(state)
        served = state >> ELAPSED_BIT
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
            later = pack(cell, place, t + 1, leg, after)
            spent = spent_on(work, t, place, leg, conflicts, served - 1)
            spent += _staying_cost(work, grid, agent, leg, served - 1)
            _serve(work, fields, grid, agent, later, served, spent, least)
        else:
            _drive_on(work, reservations, fields, grid, agent, state, least, dearest)
    # From 0 on: where the fields are full costs mean nothing, and states may wait below this one.
    work.first[: counts.top + 1] = NO_STATE
    if best == rules.INFEASIBLE:
        return False
    _trace(work, reservations, grid, agent, best ^ (agent.tie_break & rules.CODES))
    return True


@formula
def _start(work: SearchArrays, fields: DistanceFields, grid: GridMap, agent: Agent) -> int:
    """Queue the first state; returns the least possible cost."""
    middle = work.side * work.side // 2
    state = pack(agent.position, middle, 0, agent.leg, 0)
    if agent.remaining_service:
        elapsed = agent.service_time[0] - agent.remaining_service
        work.served[0, 0, 0] = 1 << elapsed
        if len(work.guided) > 0:
            work.spent_serving[0, 0, 0, elapsed] = 0
        enqueue(work, state | ((elapsed + 1) << ELAPSED_BIT), 0)
        return cost_units(work)[0] * agent.remaining_service
    # Standing on the goal is not arriving: the path leaves it like any other cell.
    mark(work, work.numbers.search, 0, middle, agent.leg, 0, 0)
    enqueue(work, state, 0)
    return _left(work, fields, grid, agent, agent.leg, agent.position)


@formula
def _staying_cost(work: SearchArrays, grid: GridMap, agent: Agent, leg: int, elapsed: int) -> int:
    """Return the cost of a timestep at a goal after `elapsed`: of service, then of waiting."""
    cost = cost_units(work)[0]
    if len(work.guided) > 0 and elapsed >= agent.service_time[leg]:
        cost = grid.costs[WAIT, agent.cell[leg]] + 0  # as a number of 64 bits
    return cost


@formula
def _left(
    work: SearchArrays, fields: DistanceFields, grid: GridMap, agent: Agent, leg: int, cell: int
) -> int:
    """Return the cost left from a cell until the current goal is done, less than 0 beyond."""
    to_go = distance(fields, grid, agent.goal[leg], cell)
    if leg == 0:
        return cost_units(work)[1] * to_go + cost_units(work)[0] * agent.service_time[0]
    if work.numbers.between == NOT_MEASURED:
        work.numbers.between = distance(fields, grid, agent.goal[1], agent.cell[0])
    return cost_units(work)[1] * (to_go - work.numbers.between)


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

    Much of a run's time is spent here: what the loop counts stays in registers, for the compiler
    must expect any array to overlap any other.
    """
    cell, place, t, leg, conflicts = unpack(state)
    goal = agent.cell[leg] if rules.ends_leg(leg, agent.service_time[leg]) else -1
    search, states, top = work.numbers.search, work.numbers.states, work.numbers.top
    spent, has_costs = spent_on(work, t, place, leg, conflicts, -1), len(work.guided) > 0
    # Waiting always costs more: once the best cost is known, it is not tried.
    for move in range(dearest < work.first.size, NUM_MOVES):
        # Masked, as an index is known not to count from the end.
        other = (cell + grid.steps[move]) & CELLS
        word = reservations.word[other]
        if word < 0:
            continue
        price = COST_UNIT
        if has_costs:
            price = grid.costs[move, cell] + 0  # as a number of 64 bits
            if price == 0:
                continue
        after = min(conflicts + is_taken(word, t, move), work.levels - 1)
        there = (place + work.steps[move]) & PLACES
        if other == goal:
            work.numbers.states, work.numbers.top = states, top
            arrived = pack(other, there, t + 1, leg, after)
            _serve(work, fields, grid, agent, arrived, 0, spent + price, least)
            states, top = work.numbers.states, work.numbers.top
        elif mark(work, search, t + 1, there, leg, after, spent + price):
            left = _left(work, fields, grid, agent, leg, other)
            cost = spent + price + left + after * agent.penalty - least
            if cost <= dearest:
                cost = link(work, states, pack(other, there, t + 1, leg, after), cost)
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
    spent: int,
    least: int,
) -> None:
    """Queue that the agent has served for `elapsed` timesteps, and may go on to the next goal."""
    cell, place, t, leg, conflicts = unpack(state)
    if (work.served[conflicts, leg, t] >> elapsed) & 1 and (
        len(work.guided) == 0 or work.spent_serving[conflicts, leg, t, elapsed] <= spent
    ):
        return
    work.served[conflicts, leg, t] |= 1 << elapsed
    if len(work.guided) > 0:
        work.spent_serving[conflicts, leg, t, elapsed] = spent
    # Counted from the goal on: a leg's service is part of what is left on the way to it.
    left = cost_units(work)[0] * max(agent.service_time[leg] - elapsed, 0)
    if leg == 1:
        service = cost_units(work)[0] * agent.service_time[1]
        left += _left(work, fields, grid, agent, 1, cell) - service
    price = conflicts * agent.penalty - least
    enqueue(work, state | ((elapsed + 1) << ELAPSED_BIT), spent + left + price)
    if leg == 0 and elapsed == agent.service_time[0]:
        if not mark(work, work.numbers.search, t, place, 1, conflicts, spent):
            return
        left = _left(work, fields, grid, agent, 1, cell)
        enqueue(work, pack(cell, place, t, 1, conflicts), spent + left + price)


@kernel
def _trace(
    work: SearchArrays, reservations: ReservationWords, grid: GridMap, agent: Agent, end: int
) -> None:
    """Read the path with this end backwards out of what the search visited."""
    path, middle = reservations.path, work.side // 2
    flipped = (agent.tie_break >> rules.CODE_BITS) & 1
    leg, conflicts, row, column, elapsed = rules.unpack_end(end, work.levels, work.side)
    if elapsed >= 0:  # in service: at the goal
        row, column = rules.find_in_window(agent.cell[leg], agent.position, grid.width, middle)
    window = path.shape[1] - 1
    spent = spent_on(work, window, row * work.side + column, leg, conflicts, elapsed)
    for t in range(window, 0, -1):
        cell = agent.position + (row - middle) * grid.width + column - middle
        path[agent.number, t] = cell
        # Leg 1 began where the service at the current goal ended.
        finished = has_served(work, conflicts, 0, t, agent.service_time[0], spent)
        if elapsed < 0 and leg == 1 and cell == agent.cell[0] and finished:
            leg, elapsed = 0, agent.service_time[0]
        word = reservations.word[cell] >> (t - 1)
        if elapsed > 0:
            spent -= _staying_cost(work, grid, agent, leg, elapsed - 1)
            fewer = has_served(work, max(conflicts - 1, 0), leg, t - 1, elapsed - 1, spent)
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
            price = COST_UNIT
            if len(work.guided) > 0:
                price = grid.costs[move, cell - grid.steps[move]] + 0  # as a number of 64 bits
                if price == 0:
                    continue
            place, number, before = i * work.side + j, leg * LEG_MARKS + conflicts, spent - price
            same = is_marked(work, t - 1, place, number, before)
            fewer = is_marked(work, t - 1, place, number - 1, before) if conflicts else 0
            conflicting = is_taken(word, 0, move)
            last = conflicts == work.levels - 1
            if rules.is_predecessor(same, fewer, conflicting, last):
                conflicts, row, column = conflicts - (conflicting & fewer), i, j
                spent = before
                break
    path[agent.number, 0] = agent.position
