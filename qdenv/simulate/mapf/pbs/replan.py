"""Plan agents again until nobody conflicts with anybody above it."""

import numpy as np

from qdenv.native import formula, kernel
from qdenv.simulate.mapf import chance
from qdenv.simulate.mapf.host.fields import Fields
from qdenv.simulate.mapf.host.site import Site
from qdenv.simulate.mapf.pbs.path import NO_PATH, find_path
from qdenv.simulate.mapf.pbs.plans import (
    BOUND,
    LAST,
    NEW,
    OLD,
    Plan,
    adopt_path,
    conflict,
    find_conflicts,
    first_of,
    note,
    parts_of,
)
from qdenv.simulate.mapf.pbs.priorities import DOWN, MARK, UP, Priorities, is_found, walk
from qdenv.simulate.mapf.pbs.reservations import (
    HERE,
    Reservations,
    forget_reservations,
    leaving,
    reserve,
)
from qdenv.simulate.mapf.pbs.workspace import CAMPS, REPLANS, WANTED, Workspace

REPLANS_PER_AGENT = 5  # within a node, beyond which it is given up
INCONSISTENT = -1


@kernel
def list_near(work: Workspace) -> None:
    """List for each agent those that it may meet within the window."""
    crowd, errands = work.crowd, work.errands
    reach = 2 * (work.plan.cell.shape[0] - 1)
    crowd.nears[:] = 0
    for agent in range(crowd.nears.size):
        for other in range(agent):
            rows = abs(errands.row[agent] - errands.row[other])
            if rows + abs(errands.column[agent] - errands.column[other]) <= reach:
                crowd.near[agent, crowd.nears[agent]] = other
                crowd.near[other, crowd.nears[other]] = agent
                crowd.nears[agent] += 1
                crowd.nears[other] += 1


@kernel
def replan(work: Workspace, fields: Fields, site: Site, agent: int, seed: int) -> bool:
    """Plan the path of an agent past those above it (after a walk up); whether there is one."""
    plan, near, terms = work.plan, work.crowd.near, work.terms
    work.tally[REPLANS] += 1
    forget_reservations(work.table)
    above = work.order.number[MARK]
    for index in range(work.crowd.nears[agent]):
        other = near[agent, index]
        if is_found(work.order, other, UP, above):
            reserve_path(work.table, plan, other, site.width)
        else:
            for t in range(1, plan.fact[BOUND, other]):
                reserve(work.table, t, work.errands.start[other], HERE)
    luck, camps = chance.mix(seed, agent) & 7, False
    last = find_path(
        work.search, work.table, fields, site, work.errands, agent, (terms.horizon, camps, luck)
    )
    if last == NO_PATH and terms.published:
        work.tally[CAMPS] += 1
        camps = True
        last = find_path(
            work.search, work.table, fields, site, work.errands, agent, (terms.horizon, camps, luck)
        )
    if last == NO_PATH:
        return False
    adopt_path(plan, work.search, work.errands, agent, (last, terms.published))
    return True


@kernel
def reserve_path(table: Reservations, plan: Plan, agent: int, width: int) -> None:
    """Reserve the path of an agent."""
    last, cell = plan.fact[LAST, agent], plan.cell[0, agent]
    for t in range(last):
        after = plan.cell[t + 1, agent]
        reserve(table, t, cell, HERE | leaving(after - cell, width))
        cell = after
    reserve(table, last, cell, HERE)


@formula
def yields(plan: Plan, order: Priorities, agent: int, other: int, t: int, mark: int) -> bool:
    """Tell whether an agent (after a walk up from it) must give way to another at a conflict.

    Whoever is bound to its start has precedence there, whatever the priorities.
    """
    if plan.cell[t, agent] == plan.cell[t, other]:
        if t < plan.fact[BOUND, agent]:
            return False
        if t < plan.fact[BOUND, other]:
            return True
    return is_found(order, other, UP, mark)


@kernel
def take_highest(work: Workspace, count: int) -> int:
    """Take an agent off the list of those who wait that has nobody above it there."""
    crowd, order = work.crowd, work.order
    place, index = 0, 0
    walk(order, crowd.waiting[0], UP)
    while index < count:
        if is_found(order, crowd.waiting[index], UP, order.number[MARK]):
            place = index
            walk(order, crowd.waiting[place], UP)
            index = 0
        else:
            index += 1
    agent = crowd.waiting[place]
    crowd.waiting[place] = crowd.waiting[count - 1]
    crowd.is_waiting[agent] = False
    return agent


@kernel
def settle(
    work: Workspace, fields: Fields, site: Site, seed: int, waiting: int, first: int, last: int
) -> int:
    """Plan those who wait again, the highest first, until nobody conflicts with anyone above it.

    Args:
        work: with a plan, its conflicts and a list of those who wait.
        fields: distances.
        site: where.
        seed: of ties.
        waiting: how many wait.
        first: the first conflict of the plan.
        last: one past them; nothing is kept beyond.

    Returns:
        One past the conflicts of the new plan, or `INCONSISTENT`; then nobody waits either.
    """
    plan, crowd, conflicts = work.plan, work.crowd, work.tree.conflict
    budget = REPLANS_PER_AGENT * crowd.nears.size
    while waiting > 0:
        agent = take_highest(work, waiting)
        waiting -= 1
        if not _gives_way(work, agent, first, last):
            continue
        budget -= 1
        if work.changes.made[0] == work.changes.agent.size:
            work.tree.number[WANTED] = 1
            budget = -1
        if budget < 0:
            break
        note(plan, work.changes, agent, OLD)
        if not replan(work, fields, site, agent, seed):
            budget = -1
            break
        note(plan, work.changes, agent, NEW)
        last = _drop_conflicts(conflicts, agent, first, last)
        find_conflicts(plan, agent)
        if last + crowd.nears.size > conflicts.size:
            work.tree.number[WANTED] = 1
            budget = -1
            break
        waiting, last = _note_conflicts(work, agent, waiting, last)
    for index in range(waiting):
        crowd.is_waiting[crowd.waiting[index]] = False
    return last if budget >= 0 else INCONSISTENT


@kernel
def _gives_way(work: Workspace, agent: int, first: int, last: int) -> bool:
    """Tell whether an agent (after a walk up) conflicts with somebody that it must give way to."""
    mark = work.order.number[MARK]
    for index in range(first, last):
        t, one, two = parts_of(work.tree.conflict[index])
        if one == agent or two == agent:
            other = one + two - agent
            if yields(work.plan, work.order, agent, other, t, mark):
                return True
    return False


@kernel
def _drop_conflicts(conflicts: np.ndarray, agent: int, first: int, last: int) -> int:
    """Drop the conflicts of an agent; returns one past what remains."""
    kept = first
    for index in range(first, last):
        pack = conflicts[index]
        _, one, two = parts_of(pack)
        if one != agent and two != agent:
            conflicts[kept] = pack
            kept += 1
    return kept


@kernel
def _note_conflicts(work: Workspace, agent: int, waiting: int, last: int) -> tuple[int, int]:
    """Note the conflicts of a new path, and let those wait who must give way to it."""
    plan, order, crowd = work.plan, work.order, work.crowd
    walked = False
    for index in range(crowd.nears[agent]):
        other = crowd.near[agent, index]
        if plan.hit[other] == 0:
            continue
        t = first_of(plan.hit[other])
        work.tree.conflict[last] = conflict(t, agent, other)
        last += 1
        if not walked:
            walk(order, agent, DOWN)
            walked = True
        loser = loser_of(plan, order, agent, other, t)
        if loser >= 0 and not crowd.is_waiting[loser]:
            crowd.is_waiting[loser] = True
            crowd.waiting[waiting] = loser
            waiting += 1
    return waiting, last


@formula
def loser_of(plan: Plan, order: Priorities, agent: int, other: int, t: int) -> int:
    """Find who must give way, after a walk down from `agent`, which avoids all above it; or -1."""
    meets = plan.cell[t, agent] == plan.cell[t, other]
    if meets and t < plan.fact[BOUND, agent]:
        return other
    if meets and t < plan.fact[BOUND, other]:
        return agent
    return other if is_found(order, other, DOWN, order.number[MARK]) else -1
