"""Plan agents again until nobody conflicts with anybody above it."""

import numpy as np

from qdenv.native import formula, kernel
from qdenv.simulate.mapf.host.fields import Fields
from qdenv.simulate.mapf.host.site import Site
from qdenv.simulate.mapf.pbs.plans import (
    BOUND,
    NEW,
    OLD,
    Plan,
    conflict,
    find_conflicts,
    first_of,
    note,
    parts_of,
)
from qdenv.simulate.mapf.pbs.priorities import DOWN, MARK, UP, Priorities, is_found, walk
from qdenv.simulate.mapf.pbs.replan import replan
from qdenv.simulate.mapf.pbs.workspace import WANTED, Crowd, Workspace

REPLANS_PER_AGENT = 5  # within a node, beyond which it is given up
INCONSISTENT = -1


@formula
def yields(plan: Plan, order: Priorities, agent: int, other: int, t: int) -> bool:
    """Tell whether an agent (after a walk up from it) must give way to another at a conflict.

    Whoever is bound to its start has precedence there, whatever the priorities.
    """
    if plan.cell[t, agent] == plan.cell[t, other]:
        if t < plan.fact[BOUND, agent]:
            return False
        if t < plan.fact[BOUND, other]:
            return True
    return is_found(order, other, UP, order.number[MARK])


@kernel
def take_highest(crowd: Crowd, order: Priorities, count: int) -> int:
    """Take an agent off the list of those who wait that has nobody above it there."""
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
        agent = take_highest(crowd, work.order, waiting)
        waiting -= 1
        others = _move_conflicts(conflicts, agent, first, last)
        if not _gives_way(plan, work.order, conflicts, agent, others, last):
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
        last = others
        find_conflicts(plan, agent)
        if last + crowd.nears.size > conflicts.size:
            work.tree.number[WANTED] = 1
            budget = -1
            break
        waiting, last = note_conflicts(
            plan, work.order, crowd, conflicts, agent, crowd.nears.size, waiting, last
        )
    for index in range(waiting):
        crowd.is_waiting[crowd.waiting[index]] = False
    return last if budget >= 0 else INCONSISTENT


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


@kernel
def _gives_way(
    plan: Plan, order: Priorities, conflicts: np.ndarray, agent: int, first: int, last: int
) -> bool:
    """Tell whether an agent must give way (after a walk up) in one of its conflicts."""
    for index in range(first, last):
        t, one, two = parts_of(conflicts[index])
        if yields(plan, order, agent, one + two - agent, t):
            return True
    return False


@kernel
def note_conflicts(
    plan: Plan,
    order: Priorities,
    crowd: Crowd,
    conflicts: np.ndarray,
    agent: int,
    others: int,
    waiting: int,
    last: int,
) -> tuple[int, int]:
    """Note the conflicts of a path, after `find_conflicts`, and let those wait who must give way.

    Args:
        plan: the joint plan.
        order: who is above whom.
        crowd: receives those who wait.
        conflicts: receives the conflicts.
        agent: whose path it is.
        others: only conflicts with agents of smaller numbers than this are noted.
        waiting: how many wait.
        last: one past the conflicts noted before.

    Returns:
        how many wait then, one past the last conflict.
    """
    walked = False
    for index in range(crowd.nears[agent]):
        other = crowd.near[agent, index]
        if other >= others or plan.hit[other] == 0:
            continue
        t = first_of(plan.hit[other])
        conflicts[last] = conflict(t, agent, other)
        last += 1
        if not walked:
            walk(order, agent, DOWN)
            walked = True
        loser = _loser(plan, order, agent, other, t)
        if loser >= 0 and not crowd.is_waiting[loser]:
            crowd.is_waiting[loser] = True
            crowd.waiting[waiting] = loser
            waiting += 1
    return waiting, last


@formula
def _loser(plan: Plan, order: Priorities, agent: int, other: int, t: int) -> int:
    """Find who must give way, after a walk down from `agent`, which avoids all above it; or -1."""
    meets = plan.cell[t, agent] == plan.cell[t, other]
    if meets and t < plan.fact[BOUND, agent]:
        return other
    if meets and t < plan.fact[BOUND, other]:
        return agent
    return other if is_found(order, other, DOWN, order.number[MARK]) else -1
