"""Plan the path of one agent past those above it."""

from qdenv.native import kernel
from qdenv.simulate.mapf import chance
from qdenv.simulate.mapf.host.fields import Fields
from qdenv.simulate.mapf.host.site import Site
from qdenv.simulate.mapf.pbs.path import NO_PATH, find_path
from qdenv.simulate.mapf.pbs.plans import BOUND, LAST, Plan, adopt_path
from qdenv.simulate.mapf.pbs.priorities import MARK, UP, is_found
from qdenv.simulate.mapf.pbs.reservations import (
    HERE,
    Reservations,
    forget_reservations,
    leaving,
    reserve,
)
from qdenv.simulate.mapf.pbs.workspace import CAMPS, REPLANS, Workspace


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
