"""Plan agents again until no agent conflicts with any that has precedence over it.

Precedence is a partial order that grows and shrinks by one pair at a time.
"""

import numpy as np

from qdenv.native import formula, kernel
from qdenv.simulate.mapf import chance
from qdenv.simulate.mapf.host.distances import DistanceFields
from qdenv.simulate.mapf.host.state import GridMap
from qdenv.simulate.mapf.pbs.path import (
    HERE,
    NO_PATH,
    find_path,
    forget_reservations,
    reserve,
    reserve_path,
)
from qdenv.simulate.mapf.pbs.workspace import (
    Changes,
    JointPlan,
    PartialOrder,
    ReplanQueue,
    Workspace,
)
from qdenv.simulate.mapf.planner import NOBODY

UP, DOWN = 0, 1  # from an agent to those above it, or to those below
OLD, NEW = 0, 1  # of a change
TIME_BIT, FIRST_BIT, AGENT_BITS = 48, 24, 24  # of a conflict, which sorts by its time
_REPLANS_PER_AGENT = 5  # within a node, beyond which it is given up
INCONSISTENT = -1


# Precedence.


@kernel
def put_above(order: PartialOrder, high: int, low: int) -> None:
    """Give one agent precedence over another."""
    pair = order.num_pairs[()]
    order.end[UP, pair], order.end[DOWN, pair] = high, low
    order.following[UP, pair], order.first[UP, low] = order.first[UP, low], pair
    order.following[DOWN, pair], order.first[DOWN, high] = order.first[DOWN, high], pair
    order.num_pairs[()] += 1


@kernel
def take_back(order: PartialOrder) -> None:
    """Take the last pair back."""
    order.num_pairs[()] -= 1
    pair = order.num_pairs[()]
    high, low = order.end[UP, pair], order.end[DOWN, pair]
    order.first[UP, low] = order.following[UP, pair]
    order.first[DOWN, high] = order.following[DOWN, pair]


@kernel
def walk(order: PartialOrder, agent: int, direction: int) -> None:
    """Find all agents above (or below) one, through any number of pairs, for `is_found`."""
    order.walk[()] += 1
    number, count = order.walk[()], 1
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
def is_found(order: PartialOrder, agent: int, direction: int, number: int) -> bool:
    """Return True if the walk of this number found an agent."""
    return order.mark[direction, agent] == number


# Conflicts.


@kernel
def find_conflicts(plan: JointPlan, agent: int) -> None:
    """Find with whom an agent conflicts, and when: bit t of ``plan.hit`` (own entry: 0).

    Two agents conflict where they are on one cell, or swap cells on the way to timestep t.
    """
    cell, hit = plan.cell, plan.hit
    for other in range(hit.size):
        hit[other] = 0
    for t in range(1, plan.path[agent].end + 1):
        here, before = cell[t, agent], cell[t - 1, agent]
        bit = np.int32(1 << t)  # of the width of `hit`, so that eight go into one instruction
        for other in range(hit.size):
            meets = cell[t, other] == here
            swaps = (cell[t, other] == before) & (cell[t - 1, other] == here)
            hit[other] |= bit if meets | swaps else np.int32(0)
    hit[agent] = 0


@kernel
def note_conflicts(
    plan: JointPlan,
    order: PartialOrder,
    queue: ReplanQueue,
    conflicts: np.ndarray,
    agent: int,
    others: int,
    waiting: int,
    last: int,
) -> tuple[int, int]:
    """Note the conflicts of a path, after `find_conflicts`, and queue those who must give way.

    Args:
        plan: the joint plan.
        order: who is above whom.
        queue: receives those who wait.
        conflicts: receives the conflicts.
        agent: whose path it is.
        others: only conflicts with agents of smaller numbers than this are noted.
        waiting: number of agents that wait.
        last: one past the conflicts noted before.

    Returns:
        The number of agents that wait then, one past the last conflict.
    """
    walked = False
    for index in range(queue.num_near[agent]):
        other = queue.near[agent, index]
        if other >= others or plan.hit[other] == 0:
            continue
        t = 0
        while not (plan.hit[other] >> t) & 1:
            t += 1
        agents = (min(agent, other) << FIRST_BIT) | max(agent, other)
        conflicts[last] = (t << TIME_BIT) | agents
        last += 1
        if not walked:
            walk(order, agent, DOWN)
            walked = True
        # The walk avoids all above the agent: who is found there is below it.
        meets = plan.cell[t, agent] == plan.cell[t, other]
        if meets and t < plan.path[agent].bound:
            loser = other
        elif meets and t < plan.path[other].bound:
            loser = agent
        else:
            loser = other if is_found(order, other, DOWN, order.walk[()]) else NOBODY
        if loser != NOBODY and not queue.is_waiting[loser]:
            queue.is_waiting[loser] = True
            queue.waiting[waiting] = loser
            waiting += 1
    return waiting, last


@formula
def parts_of(pack: int) -> tuple[int, int, int]:
    """Read time and agents of a conflict."""
    agents = (1 << AGENT_BITS) - 1
    return pack >> TIME_BIT, (pack >> FIRST_BIT) & agents, pack & agents


# Planning again.


@kernel
def resolve(
    work: Workspace,
    fields: DistanceFields,
    grid: GridMap,
    seed: int,
    waiting: int,
    first: int,
    last: int,
) -> int:
    """Plan those who wait again, the highest first, until no agent conflicts with any above it.

    Args:
        work: with a plan, its conflicts and a queue.
        fields: distances.
        grid: the layout.
        seed: of ties.
        waiting: number of agents that wait.
        first: the first conflict of the plan.
        last: one past them; nothing is kept beyond.

    Returns:
        One past the conflicts of the new plan, or `INCONSISTENT`; then no agent waits either.
    """
    plan, order, queue, conflicts = work.plan, work.order, work.queue, work.tree.conflict
    budget = _REPLANS_PER_AGENT * queue.num_near.size
    while waiting > 0:
        agent = _take_highest(queue, order, waiting)
        waiting -= 1
        others = _move_conflicts(conflicts, agent, first, last)
        gives_way = False
        for index in range(others, last):
            t, one, two = parts_of(conflicts[index])
            if _yields(plan, order, agent, one + two - agent, t):
                gives_way = True
                break
        if not gives_way:
            continue
        budget -= 1
        if work.changes.num_changes[()] == work.changes.agent.size:
            work.tree.is_full[()] = True
            budget = -1
        if budget < 0:
            break
        _note(plan, work.changes, agent, OLD)
        if not replan(work, fields, grid, agent, seed):
            budget = -1
            break
        _note(plan, work.changes, agent, NEW)
        last = others
        find_conflicts(plan, agent)
        if last + queue.num_near.size > conflicts.size:
            work.tree.is_full[()] = True
            budget = -1
            break
        waiting, last = note_conflicts(
            plan, order, queue, conflicts, agent, queue.num_near.size, waiting, last
        )
    for index in range(waiting):
        queue.is_waiting[queue.waiting[index]] = False
    return last if budget >= 0 else INCONSISTENT


@kernel
def _take_highest(queue: ReplanQueue, order: PartialOrder, count: int) -> int:
    """Take an agent that has none above it there off the queue, after a walk up from it."""
    place, index = 0, 0
    walk(order, queue.waiting[0], UP)
    while index < count:
        if is_found(order, queue.waiting[index], UP, order.walk[()]):
            place = index
            walk(order, queue.waiting[place], UP)
            index = 0
        else:
            index += 1
    agent = queue.waiting[place]
    queue.waiting[place] = queue.waiting[count - 1]
    queue.is_waiting[agent] = False
    return agent


@kernel
def _move_conflicts(conflicts: np.ndarray, agent: int, first: int, last: int) -> int:
    """Move the conflicts of an agent behind all others; returns where they begin."""
    index = first
    while index < last:
        pack = conflicts[index]
        _, one, two = parts_of(pack)
        if one == agent or two == agent:
            last -= 1
            conflicts[index], conflicts[last] = conflicts[last], pack
        else:
            index += 1
    return last


@formula
def _yields(plan: JointPlan, order: PartialOrder, agent: int, other: int, t: int) -> bool:
    """Return True if an agent (after a walk up from it) must give way to another at a conflict.

    An agent that is bound to its start has precedence there, whatever the priorities.
    """
    if plan.cell[t, agent] == plan.cell[t, other]:
        if t < plan.path[agent].bound:
            return False
        if t < plan.path[other].bound:
            return True
    return is_found(order, other, UP, order.walk[()])


@kernel
def _note(plan: JointPlan, changes: Changes, agent: int, when: int) -> None:
    """Write the path of an agent down, before (`OLD`) or after (`NEW`) a change."""
    change = changes.num_changes[()]
    changes.agent[change] = agent
    for t in range(plan.cell.shape[0]):
        changes.cell[change, when, t] = plan.cell[t, agent]
    changes.path[change, when] = plan.path[agent]
    changes.num_changes[()] += when


@kernel
def redo(plan: JointPlan, changes: Changes, change: int, when: int) -> None:
    """Make one change (`NEW`), or undo it (`OLD`)."""
    agent = changes.agent[change]
    plan.delay[()] += changes.path[change, when].delay - plan.path[agent].delay
    for t in range(plan.cell.shape[0]):
        plan.cell[t, agent] = changes.cell[change, when, t]
    plan.path[agent] = changes.path[change, when]


@kernel
def replan(work: Workspace, fields: DistanceFields, grid: GridMap, agent: int, seed: int) -> bool:
    """Plan the path of an agent past those above it (after a walk up); False if there is none."""
    plan, goals, search = work.plan, work.goals, work.search
    forget_reservations(work.table)
    above = work.order.walk[()]
    for index in range(work.queue.num_near[agent]):
        other = work.queue.near[agent, index]
        if is_found(work.order, other, UP, above):
            reserve_path(work.table, plan, other, grid.width)
        else:
            for t in range(1, plan.path[other].bound):
                reserve(work.table, t, goals.start[other], HERE)
    ties = chance.mix(seed, agent) & 7
    last = find_path(search, work.table, fields, grid, goals, agent, False, ties)
    if last == NO_PATH and work.published:
        last = find_path(search, work.table, fields, grid, goals, agent, True, ties)
    if last == NO_PATH:
        return False
    start, bound = goals.start[agent], min(goals.begin[agent], last) + 1
    # In the published planner, waiting at the start has precedence there.
    while work.published and bound <= last and search.cells[bound] == start:
        bound += 1
    path = plan.path[agent]
    plan.delay[()] += search.delay[()] - path.delay
    path.end, path.bound, path.delay = last, bound, search.delay[()]
    for t in range(plan.cell.shape[0]):
        plan.cell[t, agent] = search.cells[t] if t <= last else -1 - agent
    return True
