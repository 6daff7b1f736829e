"""The planner: windowed priority-based search, as in the published simulator.

Every `horizon` timesteps all agents are planned from scratch for a window, by a tree of partial
orders, searched depth first: Ma et al. 2019, "Searching with consistent prioritization for
multi-agent path finding", https://arxiv.org/abs/1812.06356, algorithm 1; for windows, Li et al.
2021, https://arxiv.org/abs/2005.07371. A node is a partial order of the agents with a path for each
that avoids those of all above it. While two agents conflict, one child puts the first above the
second and the other the reverse; the one with the shorter paths is searched first, of equals the
one with fewer conflicts.

Only the node in hand is there as a whole. The others are the changes that lead to them, and their
conflicts: so a node costs what it changes.

Deviations from the published program: two goals are always known, services are checked to find
their cell free, the limit is one of nodes and not of time, and an unsolved window is driven by PIBT
where its best plan has conflicts.
"""

from qdenv.native import kernel, shared
from qdenv.simulation.mapf import chance
from qdenv.simulation.mapf.host.distances import DistanceFields, distance
from qdenv.simulation.mapf.host.run import DONE, FIELDS_FULL, PLAN_FULL, Fallback, compile_windows
from qdenv.simulation.mapf.host.state import GridMap, HostRun, service_time
from qdenv.simulation.mapf.pbs import conflicts, workspace
from qdenv.simulation.mapf.pbs.workspace import FIRST_DEPTH, Goals, Workspace, make_workspace
from qdenv.simulation.mapf.planner import KNOWN, NOBODY, Planner
from qdenv.simulation.mapf.settings import PbsConfig

_MAX_WINDOW = 30  # the timesteps of conflicts are the bits of one word
_PREFERRED = 1 << 60  # taken off a conflict that comes first


def pbs(settings: PbsConfig) -> Planner:
    """Make the planner, which exists in compiled host code only."""
    return Planner(
        plan=None,
        max_window=_MAX_WINDOW,
        run_windows=_run_windows,
        make_plan=lambda run, size: make_workspace(run, settings, FIRST_DEPTH * size),
        reads_costs=True,
    )


@shared
def _plan_window(
    run: HostRun, fields: DistanceFields, work: Workspace, fallback: Fallback, seed: int
) -> int:
    """Plan a window; agents that conflict in the best plan of an unsolved one fall back."""
    collect_goals(run, fields, work.goals)
    solved = solve(work, fields, run.grid, chance.mix(seed, chance.TIES))
    if fields.numbers.is_full:
        return FIELDS_FULL
    if work.numbers.is_full:
        return PLAN_FULL
    work.numbers.unsolved += not solved
    plan, path, is_used, horizon = work.plan, fallback.path, fallback.is_used, run.settings.horizon
    for t in range(0 if solved else path.shape[1]):
        for agent in range(is_used.size):
            plan.cell[t, agent] = work.best[t, agent]
    for agent in range(is_used.size):
        is_used[agent] = False
        if not solved:
            plan.path[agent].end = horizon  # later conflicts do not matter
            conflicts.find_conflicts(plan, agent)
            is_used[agent] = plan.hit.any()
        path[agent, 0] = run.position[agent]
        for t in range(1, path.shape[1]):
            # The last cell of a path that has ended is repeated; within the driven steps only those
            # agents have none that have no path.
            ended = plan.cell[t, agent] < 0
            path[agent, t] = path[agent, t - 1] if ended else plan.cell[t, agent]
            is_used[agent] = is_used[agent] or (ended and t <= horizon)
    return DONE


_run_windows = compile_windows(_plan_window)


@kernel
def collect_goals(run: HostRun, fields: DistanceFields, goals: Goals) -> None:
    """Note what the agents have to do now."""
    grid = run.grid
    for agent in range(run.position.size):
        for leg in range(KNOWN):
            goals.cell[leg, agent] = grid.goals[run.goal[leg, agent]]
            goals.service_time[leg, agent] = service_time(run, agent, leg)
        goals.leg[agent] = run.remaining_service[agent] > 0
        if run.kind[agent] == len(grid.odds):
            at_place = run.position[agent] == goals.cell[0, agent]
            goals.leg[agent] = workspace.SERVED if at_place else 1
        goals.between[agent] = distance(fields, grid, run.goal[1, agent], goals.cell[0, agent])


@kernel
def solve(work: Workspace, fields: DistanceFields, grid: GridMap, seed: int) -> bool:
    """Search for paths without conflicts; returns whether they were found, in ``work.plan``.

    If not, ``work.best`` is the plan whose first conflict is latest; neither counts if an
    array was too small (``work.numbers.is_full``).
    """
    plan, counts = work.plan, work.numbers
    work.dead_end[:] = False
    counts.is_full, counts.best_time = False, -1
    if not _plan_root(work, fields, grid, seed):
        _keep_best(work, 0)
        return False
    first, last, depth, nodes = 0, counts.conflicts, 0, 0
    while first < last:
        # The earliest conflict, but before it any whose agents had no feasible child once.
        earliest, best, pick = work.conflict[first], _PREFERRED, work.conflict[first]
        for index in range(first, last):
            pack = work.conflict[index]
            earliest = min(earliest, pack)
            _, one, two = conflicts.parts_of(pack)
            key = pack - _PREFERRED if work.dead_end[one, two] else pack
            if key < best:
                best, pick = key, pack
        _keep_best(work, conflicts.parts_of(earliest)[0])
        if depth == work.node.size and nodes < work.node_limit:
            counts.is_full = True
        if nodes == work.node_limit or counts.is_full:
            return False
        nodes += 1
        counts.nodes += 1
        _expand(work, fields, grid, seed, depth, pick, first, last)
        # Go back up until there is a child to search next, undoing the changes on the way.
        node = work.node[depth]
        while node.num_entered == node.num_children:
            plan.numbers.changes, counts.conflicts = node.num_changes, node.num_conflicts
            if depth == 0:
                return False
            depth -= 1
            node = work.node[depth]
            child = work.child[depth, (node.num_entered - 1) ^ node.is_swapped]
            for change in range(child.end_change - 1, child.first_change - 1, -1):
                conflicts.redo(plan, change, conflicts.OLD)
            conflicts.take_back(work.order)
        child = work.child[depth, node.num_entered ^ node.is_swapped]
        node.num_entered += 1
        conflicts.put_above(work.order, child.high, child.low)
        for change in range(child.first_change, child.end_change):
            conflicts.redo(plan, change, conflicts.NEW)
        first, last = child.first_conflict, child.end_conflict
        depth += 1
    return True


@kernel
def _plan_root(work: Workspace, fields: DistanceFields, grid: GridMap, seed: int) -> bool:
    """Plan all agents, one after the other; returns False if they cannot be made consistent.

    No agent has precedence but those that are bound to their start.
    """
    plan, goals, counts = work.plan, work.goals, work.numbers
    agents, window = work.num_near.size, plan.cell.shape[0] - 1
    work.num_near[:] = 0
    for agent in range(agents):
        row = goals.start[agent] // grid.width
        column = goals.start[agent] - row * grid.width
        for other in range(agent):
            other_row = goals.start[other] // grid.width
            other_column = goals.start[other] - other_row * grid.width
            # Two agents that go towards one another for the whole window.
            if abs(row - other_row) + abs(column - other_column) <= 2 * window:
                work.near[agent, work.num_near[agent]] = other
                work.near[other, work.num_near[other]] = agent
                work.num_near[agent] += 1
                work.num_near[other] += 1
    work.order.first[:] = NOBODY
    work.order.numbers.pairs = 0
    # At first only those are anywhere whom a service keeps at their start: all know of them.
    for agent in range(agents):
        last = min(goals.begin[agent], window)
        path = plan.path[agent]
        path.end, path.bound, path.delay = last, last + 1, 0
        for t in range(window + 1):
            plan.cell[t, agent] = goals.start[agent] if t <= last else -1 - agent
    plan.numbers.delay, plan.numbers.changes = 0, 0
    counts.conflicts, counts.waiting = 0, 0
    for agent in range(agents):
        conflicts.walk(work.order, agent, conflicts.UP)
        if not conflicts.replan(work, fields, grid, agent, seed):
            return False
        plan.numbers.changes = 0  # never taken back
    for agent in range(agents):
        if not conflicts.note_conflicts(work, agent, agent):
            return False
    consistent = conflicts.resolve(work, fields, grid, seed, 0)
    plan.numbers.changes = 0
    return consistent


@kernel
def _keep_best(work: Workspace, earliest: int) -> None:
    """Keep the plan if its first conflict is later than all before, or as late with less delay."""
    counts, best, plan = work.numbers, work.best, work.plan
    delay = plan.numbers.delay
    if earliest > counts.best_time or (earliest == counts.best_time and delay < counts.best_delay):
        counts.best_time, counts.best_delay = earliest, delay
        for t in range(best.shape[0]):
            for agent in range(best.shape[1]):
                best[t, agent] = plan.cell[t, agent]


@kernel
def _expand(
    work: Workspace,
    fields: DistanceFields,
    grid: GridMap,
    seed: int,
    depth: int,
    pick: int,
    first: int,
    last: int,
) -> None:
    """Make the children of a node, which is in hand before and after, from one of its conflicts."""
    counts, order, plan = work.numbers, work.order, work.plan
    node, children = work.node[depth], work.child[depth]
    _, one, two = conflicts.parts_of(pick)
    node.num_changes, node.num_conflicts = plan.numbers.changes, counts.conflicts
    node.num_children, node.num_entered, node.is_swapped = 0, 0, 0
    for side in range(2):
        low, high = (one, two) if side == 0 else (two, one)
        conflicts.walk(order, high, conflicts.UP)
        if conflicts.is_found(order, low, conflicts.UP):
            continue
        begin, change = counts.conflicts, plan.numbers.changes
        if begin + last - first > work.conflict.size:
            counts.is_full = True
            continue
        for index in range(last - first):
            work.conflict[begin + index] = work.conflict[first + index]
        counts.conflicts += last - first
        conflicts.put_above(order, high, low)
        work.waiting[0], work.is_waiting[low], work.numbers.waiting = low, True, 1
        consistent = conflicts.resolve(work, fields, grid, seed, begin)
        child = children[node.num_children]
        child.high, child.low, child.cost = high, low, plan.numbers.delay
        conflicts.take_back(order)
        for index in range(plan.numbers.changes - 1, change - 1, -1):
            conflicts.redo(plan, index, conflicts.OLD)
        if consistent:
            child.first_conflict, child.end_conflict = begin, counts.conflicts
            child.first_change, child.end_change = change, plan.numbers.changes
            node.num_children += 1
        else:
            plan.numbers.changes, counts.conflicts = change, begin
    if node.num_children == 0:
        work.dead_end[one, two] = True
    elif node.num_children == 2:
        many = children[0].end_conflict - children[0].first_conflict
        few = children[1].end_conflict - children[1].first_conflict
        more, less = children[0].cost, children[1].cost
        node.is_swapped = less < more or (less == more and few <= many)
