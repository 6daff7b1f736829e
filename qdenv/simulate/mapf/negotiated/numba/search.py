"""The best path of one agent through a window, past the reservations of the others.

The paths that `xla.search` finds, by A* over delays (Hart, Nilsson and Raphael 1968,
https://doi.org/10.1109/TSSC.1968.300136) instead of sets of cells: what a state costs at least
follows from the state alone, and never falls along a path. So states are visited once, in the order
of their cost, until all those of the cheapest end are: these hold every best path, hence ties fall
as they do in XLA. Most searches end among the shortest ways without a conflict, a dozen states.
"""

from qdenv.native import formula, kernel
from qdenv.simulate.mapf.host.fields import Fields
from qdenv.simulate.mapf.host.measure import INDICES, distance
from qdenv.simulate.mapf.host.site import Site
from qdenv.simulate.mapf.negotiated import path_rules, rules
from qdenv.simulate.mapf.negotiated.numba.reservations import (
    Reservations,
    is_reserved,
    is_taken,
)
from qdenv.simulate.mapf.negotiated.numba.states import (
    BETWEEN,
    CELLS,
    ELAPSED_BIT,
    NO_STATE,
    NOT_MEASURED,
    PLACES,
    SEARCH,
    STATES,
    TIME_BIT,
    TIMES,
    TOP,
    Agent,
    Workspace,
    enqueue,
    in_range,
    link,
    mark,
    pack,
    unpack,
)


@kernel
def find_path(
    work: Workspace, reservations: Reservations, fields: Fields, site: Site, agent: Agent
) -> int:
    """Find the best path of one agent; returns the code of its end, or -1 where there is none."""
    work.number[STATES], work.number[TOP], work.number[BETWEEN] = 0, 0, NOT_MEASURED
    work.number[SEARCH] += 1
    for conflicts in range(work.levels):
        for leg in range(path_rules.LEGS):
            for t in range(work.served.shape[2]):
                work.served[conflicts, leg, t] = 0
    least = _start(work, fields, site, agent)
    best, cost, dearest = path_rules.INFEASIBLE, 0, work.first.size
    while cost <= work.number[TOP]:
        index = work.first[cost]
        if index == NO_STATE:
            if best < path_rules.INFEASIBLE:
                break  # all of its cost were visited
            cost += 1
            continue
        index &= INDICES
        work.first[cost] = work.later[index]
        state = work.state[index]
        if (state >> TIME_BIT) & TIMES == work.mark.shape[0] - 1:
            best = min(best, _end_code(work, state) ^ path_rules.tie_breaker(agent.noise))
            dearest = cost
        elif state >> ELAPSED_BIT:
            _serve_on(work, reservations, fields, site, agent, state, least)
        else:
            _drive_on(work, reservations, fields, site, agent, state, least, dearest)
    # From 0 on: where fields lack room costs mean nothing, and states may wait below this one.
    for other in range(work.number[TOP] + 1):
        work.first[other] = NO_STATE
    found = best < path_rules.INFEASIBLE
    return best ^ path_rules.tie_breaker(agent.noise) if found else -1


@formula
def _start(work: Workspace, fields: Fields, site: Site, agent: Agent) -> int:
    """Queue the first state; returns the least possible cost."""
    middle = work.side * work.side // 2
    if agent.remaining_service:
        elapsed = agent.service_time[0] - agent.remaining_service
        state = pack(agent.position, middle, 0, 0, 0)
        work.served[0, 0, 0] = 1 << elapsed
        enqueue(work, state | ((elapsed + 1) << ELAPSED_BIT), 0)
        return path_rules.COST_UNIT * agent.remaining_service
    # Standing on the goal is not arriving: the path leaves it like any other cell.
    mark(work, work.number[SEARCH], 0, middle, 0, 0)
    enqueue(work, pack(agent.position, middle, 0, 0, 0), 0)
    left = distance(fields, site, agent.goal[0], agent.position) + agent.service_time[0]
    return path_rules.COST_UNIT * left


@formula
def _left(work: Workspace, fields: Fields, site: Site, agent: Agent, leg: int, cell: int) -> int:
    """Count the timesteps left from a cell until the current goal is done, less than 0 beyond."""
    if leg == 0:
        return distance(fields, site, agent.goal[0], cell) + agent.service_time[0]
    if work.number[BETWEEN] == NOT_MEASURED:
        work.number[BETWEEN] = distance(fields, site, agent.goal[1], agent.cell[0])
    return distance(fields, site, agent.goal[1], cell) - work.number[BETWEEN]


@formula
def _drive_on(
    work: Workspace,
    reservations: Reservations,
    fields: Fields,
    site: Site,
    agent: Agent,
    state: int,
    least: int,
    dearest: int,
) -> None:
    """Visit a driving state: queue what one step leads to, if it costs no more than `dearest`.

    Half of a run's time is spent here: what the loop counts stays in registers, for the compiler
    must expect any array to overlap any other.
    """
    cell, place, t, leg, conflicts = unpack(state)
    goal = agent.cell[leg] if rules.ends_leg(leg, agent.service_time[leg]) else -1
    search, states, top = work.number[SEARCH], work.number[STATES], work.number[TOP]
    # Waiting always costs a timestep more: once the best cost is known, nobody does.
    for move in range(dearest < work.first.size, rules.MOVES):
        other = (cell + site.steps[move]) & CELLS
        word = reservations.word[other]
        if word < 0:
            continue
        after = min(conflicts + is_taken(word, t, move), work.levels - 1)
        there = (place + work.steps[move]) & PLACES
        if other == goal:
            work.number[STATES], work.number[TOP] = states, top
            _serve(work, fields, site, agent, pack(other, there, t + 1, leg, after), 0, least)
            states, top = work.number[STATES], work.number[TOP]
        elif mark(work, search, t + 1, there, leg, after):
            left = t + 1 + _left(work, fields, site, agent, leg, other)
            cost = in_range(work, path_rules.COST_UNIT * left + after * agent.penalty - least)
            if cost <= dearest:
                link(work, states, pack(other, there, t + 1, leg, after), cost)
                states, top = states + 1, max(top, cost)
    work.number[STATES], work.number[TOP] = states, top


@kernel
def _serve_on(
    work: Workspace,
    reservations: Reservations,
    fields: Fields,
    site: Site,
    agent: Agent,
    state: int,
    least: int,
) -> None:
    """Visit a serving state: serve for one timestep more."""
    cell, place, t, leg, conflicts = unpack(state)
    after = min(conflicts + is_reserved(reservations.word[cell], t), work.levels - 1)
    elapsed = state >> ELAPSED_BIT
    _serve(work, fields, site, agent, pack(cell, place, t + 1, leg, after), elapsed, least)


@kernel
def _serve(
    work: Workspace,
    fields: Fields,
    site: Site,
    agent: Agent,
    state: int,
    elapsed: int,
    least: int,
) -> None:
    """Queue that somebody has served for `elapsed` timesteps, and may go on to the next goal."""
    cell, place, t, leg, conflicts = unpack(state)
    if (work.served[conflicts, leg, t] >> elapsed) & 1:
        return
    work.served[conflicts, leg, t] |= 1 << elapsed
    still = max(agent.service_time[leg] - elapsed, 0)
    # Counted from the goal on: a leg's service is part of what is left on the way to it.
    left = still
    if leg == 1:
        left += _left(work, fields, site, agent, 1, cell) - agent.service_time[1]
    price = conflicts * agent.penalty - least
    cost = path_rules.COST_UNIT * (t + left) + price
    enqueue(work, state | ((elapsed + 1) << ELAPSED_BIT), cost)
    if leg == 0 and elapsed == agent.service_time[0]:
        if not mark(work, work.number[SEARCH], t, place, 1, conflicts):
            return
        left = _left(work, fields, site, agent, 1, cell)
        cost = path_rules.COST_UNIT * (t + left) + price
        enqueue(work, pack(cell, place, t, 1, conflicts), cost)


@kernel
def _end_code(work: Workspace, state: int) -> int:
    """Give the end of a path its code."""
    _, place, _, leg, conflicts = unpack(state)
    served = state >> ELAPSED_BIT
    if served:
        return path_rules.serving_end(leg, conflicts, work.levels, served - 1, work.side)
    row, column = place // work.side, place % work.side
    return path_rules.driving_end(leg, conflicts, work.levels, row, column, work.side)
