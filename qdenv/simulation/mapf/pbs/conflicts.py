"""Plan agents again until no agent conflicts with any that has precedence over it.

Precedence is a partial order that grows and shrinks by one pair at a time.
"""

import numpy as np

from qdenv.native import formula, kernel
from qdenv.simulation.mapf import chance
from qdenv.simulation.mapf.host.distances import DistanceFields
from qdenv.simulation.mapf.host.state import GridMap
from qdenv.simulation.mapf.pbs import path as paths
from qdenv.simulation.mapf.pbs.workspace import SERVED, JointPlan, PartialOrder, Workspace
from qdenv.simulation.mapf.planner import NOBODY

UP, DOWN = 0, 1  # from an agent to those above it, or to those below
OLD, NEW = 0, 1  # of a change
_TIME_BIT, _FIRST_BIT, _AGENTS = 48, 24, (1 << 24) - 1  # of a conflict, which sorts by its time
_REPLANS_PER_AGENT = 5  # within a node, beyond which it is given up


@kernel
def put_above(order: PartialOrder, high: int, low: int) -> None:
    """Give one agent precedence over another."""
    pair = order.numbers.pairs
    order.end[UP, pair], order.end[DOWN, pair] = high, low
    order.following[UP, pair], order.first[UP, low] = order.first[UP, low], pair
    order.following[DOWN, pair], order.first[DOWN, high] = order.first[DOWN, high], pair
    order.numbers.pairs += 1


@kernel
def take_back(order: PartialOrder) -> None:
    """Take the last pair back."""
    order.numbers.pairs -= 1
    pair = order.numbers.pairs
    high, low = order.end[UP, pair], order.end[DOWN, pair]
    order.first[UP, low] = order.following[UP, pair]
    order.first[DOWN, high] = order.following[DOWN, pair]


@kernel
def walk(order: PartialOrder, agent: int, direction: int) -> None:
    """Find all agents above (or below) one, through any number of pairs, for `is_found`."""
    order.numbers.walk += 1
    number, count = order.numbers.walk, 1
    order.stack[0] = agent
    while count > 0:
        count -= 1
        pair = order.first[direction, order.stack[count]]
        while pair != NOBODY:
            other = order.end[direction, pair]
            if order.mark[direction, other] != number:
                order.mark[direction, other] = number
                order.stack[count] = other
                count += 1
            pair = order.following[direction, pair]


@formula
def is_found(order: PartialOrder, agent: int, direction: int) -> bool:
    """Return True if the last walk, in this direction, found an agent."""
    return order.mark[direction, agent] == order.numbers.walk


@formula
def parts_of(pack: int) -> tuple[int, int, int]:
    """Read time and agents of a conflict, the smaller number first."""
    return pack >> _TIME_BIT, (pack >> _FIRST_BIT) & _AGENTS, pack & _AGENTS


@formula
def _bound_at(plan: JointPlan, one: int, two: int, t: int) -> int:
    """Return which of two agents in conflict is bound to its start then, or `NOBODY`.

    It has precedence there, whatever the priorities.
    """
    first = NOBODY
    if plan.cell[t, one] == plan.cell[t, two]:
        if t < plan.path[one].bound:
            first = one
        elif t < plan.path[two].bound:
            first = two
    return first


@kernel
def find_conflicts(plan: JointPlan, agent: int) -> None:
    """Find with whom an agent conflicts, and when: bit t of ``plan.hit`` (own entry: 0).

    Two agents conflict where they are on one cell, or swap cells on the way to timestep t.
    """
    cell, hit = plan.cell, plan.hit
    hit[:] = 0
    for t in range(1, plan.path[agent].end + 1):
        here, before = cell[t, agent], cell[t - 1, agent]
        bit = np.int32(1 << t)  # of the width of `hit`, so that eight go into one instruction
        for other in range(hit.size):
            meets = cell[t, other] == here
            swaps = (cell[t, other] == before) & (cell[t - 1, other] == here)
            hit[other] |= bit if meets | swaps else np.int32(0)
    hit[agent] = 0


@kernel
def note_conflicts(work: Workspace, agent: int, others: int) -> bool:
    """Note the conflicts of an agent's path with those of agents below the number `others`.

    Those who must give way are queued. Returns False if there may be too many conflicts.
    """
    plan, order, counts = work.plan, work.order, work.numbers
    if counts.conflicts + others > work.conflict.size:
        counts.is_full = True
        return False
    find_conflicts(plan, agent)
    walked = False
    for index in range(work.num_near[agent]):
        other = work.near[agent, index]
        if other >= others or plan.hit[other] == 0:
            continue
        t = 0
        while not (plan.hit[other] >> t) & 1:
            t += 1
        agents = (min(agent, other) << _FIRST_BIT) | max(agent, other)
        work.conflict[counts.conflicts] = (t << _TIME_BIT) | agents
        counts.conflicts += 1
        if not walked:
            walk(order, agent, DOWN)
            walked = True
        # The path avoids all above the agent: who is in conflict and found is below it.
        first, loser = _bound_at(plan, agent, other, t), NOBODY
        if first == other:
            loser = agent
        elif first == agent or is_found(order, other, DOWN):
            loser = other
        if loser != NOBODY and not work.is_waiting[loser]:
            work.is_waiting[loser] = True
            work.waiting[counts.waiting] = loser
            counts.waiting += 1
    return True


@kernel
def resolve(work: Workspace, fields: DistanceFields, grid: GridMap, seed: int, first: int) -> bool:
    """Plan those who wait again, the highest first, until no agent conflicts with any above it.

    On success the conflicts from number `first` on are those of the new plan. Returns False if
    there is none; either way no agent waits any more.
    """
    plan, order, counts = work.plan, work.order, work.numbers
    budget, consistent = _REPLANS_PER_AGENT * work.num_near.size, True
    while consistent and counts.waiting > 0:
        agent = _take_highest(work)
        # Move the conflicts of the agent behind all others.
        index, others = first, counts.conflicts
        gives_way = False
        while index < others:
            pack = work.conflict[index]
            t, one, two = parts_of(pack)
            if one != agent and two != agent:
                index += 1
                continue
            others -= 1
            work.conflict[index], work.conflict[others] = work.conflict[others], pack
            above = one + two - agent
            bound = _bound_at(plan, agent, above, t)
            gives_way |= bound == above or (bound == NOBODY and is_found(order, above, UP))
        if gives_way:
            budget -= 1
            consistent = budget >= 0 and replan(work, fields, grid, agent, seed)
            if consistent:
                counts.conflicts = others
                consistent = note_conflicts(work, agent, work.num_near.size)
    for index in range(counts.waiting):
        work.is_waiting[work.waiting[index]] = False
    counts.waiting = 0
    return consistent


@kernel
def _take_highest(work: Workspace) -> int:
    """Dequeue an agent with none above it in the queue, after a walk up from it."""
    order, waiting = work.order, work.waiting
    place, index = 0, 0
    walk(order, waiting[0], UP)
    while index < work.numbers.waiting:
        if is_found(order, waiting[index], UP):
            place = index
            walk(order, waiting[place], UP)
            index = 0
        else:
            index += 1
    agent = waiting[place]
    work.numbers.waiting -= 1
    waiting[place] = waiting[work.numbers.waiting]
    work.is_waiting[agent] = False
    return agent


@kernel
def redo(plan: JointPlan, change: int, when: int) -> None:
    """Make one change (`NEW`), or undo it (`OLD`)."""
    agent = plan.changed[change]
    plan.numbers.delay += plan.change_path[change, when].delay - plan.path[agent].delay
    for t in range(plan.cell.shape[0]):
        plan.cell[t, agent] = plan.change_cell[change, when, t]
    plan.path[agent] = plan.change_path[change, when]


@kernel
def replan(work: Workspace, fields: DistanceFields, grid: GridMap, agent: int, seed: int) -> bool:
    """Plan the path of an agent past those above it (after a walk up); False if there is none.

    What changes is written down.
    """
    plan, goals, search, change = work.plan, work.goals, work.search, work.plan.numbers.changes
    if change == plan.changed.size:
        work.numbers.is_full = True
        return False
    paths.forget_reservations(search)
    for index in range(work.num_near[agent]):
        other = work.near[agent, index]
        if is_found(work.order, other, UP):
            paths.reserve_path(search, plan, other, grid.width)
        else:
            for t in range(1, plan.path[other].bound):
                paths.reserve(search, t, goals.start[other], paths.HERE)
    ties = chance.mix(seed, agent) & 7
    last = paths.find_path(search, fields, grid, goals, agent, False, ties)
    if last == paths.NO_PATH and work.published:
        last = paths.find_path(search, fields, grid, goals, agent, True, ties)
    if last == paths.NO_PATH:
        return False
    bound = min(goals.begin[agent], last) + 1
    # In the published planner, waiting at the start has precedence there; not of idle agents.
    precedes = work.published and goals.leg[agent] < SERVED
    while precedes and bound <= last and search.cells[bound] == goals.start[agent]:
        bound += 1
    plan.changed[change], plan.change_path[change, OLD] = agent, plan.path[agent]
    path = plan.change_path[change, NEW]
    path.end, path.bound, path.delay = last, bound, search.numbers.delay
    for t in range(plan.cell.shape[0]):
        plan.change_cell[change, OLD, t] = plan.cell[t, agent]
        plan.change_cell[change, NEW, t] = search.cells[t] if t <= last else -1 - agent
    plan.numbers.changes += 1
    redo(plan, change, NEW)
    return True
