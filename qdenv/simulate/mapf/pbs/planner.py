"""The planner: windowed priority-based search, as in the published simulator.

Every `horizon` timesteps all agents are planned from scratch for a window, by a tree of partial
orders, searched depth first: Ma et al. 2019, "Searching with consistent prioritization for
multi-agent path finding", https://arxiv.org/abs/1812.06356, algorithm 1; for windows, Li et al.
2021, https://arxiv.org/abs/2005.07371. A node is a partial order of the agents with a path for each
that avoids those of all above it. While two agents conflict, one child puts the first above the
second and the other the reverse; the one with the shorter paths is searched first, of equals the
one with fewer conflicts.

Only the node in hand is kept as a whole. The others are the changes that lead there, and their
conflicts: so a node costs what it changes.

Deviations from the published program: two goals are always known, services are checked to find
their cell free, the limit is one of nodes and not of time, and an unsolved window is driven by PIBT
where its best plan has conflicts.
"""

import numpy as np

from qdenv.native import formula, kernel, shared
from qdenv.simulate.mapf import chance
from qdenv.simulate.mapf.host.distances import DistanceFields, distance
from qdenv.simulate.mapf.host.run import (
    DONE,
    FIELDS_FULL,
    PLAN_FULL,
    Fallback,
    compile_windows,
)
from qdenv.simulate.mapf.host.state import GridMap, HostRun
from qdenv.simulate.mapf.pbs.conflicts import (
    INCONSISTENT,
    NEW,
    OLD,
    UP,
    find_conflicts,
    is_found,
    note_conflicts,
    parts_of,
    put_above,
    redo,
    replan,
    resolve,
    take_back,
    walk,
)
from qdenv.simulate.mapf.pbs.settings import MAX_WINDOW, PbsConfig
from qdenv.simulate.mapf.pbs.workspace import (
    FIRST_DEPTH,
    NUM_GOALS,
    Goals,
    JointPlan,
    SearchTree,
    Workspace,
    make_workspace,
)
from qdenv.simulate.mapf.planner import NOBODY, HostPlanner, Planner

_PREFERRED = 1 << 60  # taken off a conflict that comes first


def pbs(settings: PbsConfig) -> Planner:
    """Make the planner, which exists in compiled host code only."""

    def make_plan(run: HostRun, size: int) -> Workspace:
        return make_workspace(run, settings, FIRST_DEPTH * size)

    return Planner(None, MAX_WINDOW, host=HostPlanner(make_plan, _run_windows))


@shared
def _plan_window(
    run: HostRun, fields: DistanceFields, work: Workspace, fallback: Fallback, seed: int
) -> int:
    """Plan a window; agents that conflict in the best plan of an unsolved one fall back."""
    collect_goals(run, fields, work.goals)
    solved = solve(work, fields, run.grid, chance.mix(seed, chance.TIES))
    if fields.numbers.is_full:
        return FIELDS_FULL
    if work.tree.is_full[()]:
        return PLAN_FULL
    work.num_unsolved[()] += not solved
    _read_plan(run, work.plan.cell if solved else work.tree.best, fallback, solved)
    return DONE


_run_windows = compile_windows(_plan_window)


@kernel
def collect_goals(run: HostRun, fields: DistanceFields, goals: Goals) -> None:
    """Note what the agents have to do now."""
    grid, agents = run.grid, run.agents
    kinds = grid.service_time.size
    for agent in range(agents.position.size):
        goals.start[agent] = agents.position[agent]
        goals.row[agent] = agents.position[agent] // grid.width
        goals.column[agent] = agents.position[agent] % grid.width
        goals.begin[agent] = agents.remaining_service[agent]
        for leg in range(NUM_GOALS):
            slot = agents.goal[leg, agent]
            goals.goal[leg, agent], goals.cell[leg, agent] = slot, grid.goals[slot]
            kind = (agents.kind[agent] + leg) % kinds
            goals.service_time[leg, agent] = grid.service_time[kind]
        second = goals.goal[1, agent]
        goals.between[agent] = distance(fields, grid, second, goals.cell[0, agent])


@kernel
def _read_plan(run: HostRun, plan: np.ndarray, fallback: Fallback, solved: bool) -> None:
    """Hand a plan (int32 [w + 1, A]) over; the last cell of a path that has ended is repeated."""
    path, is_used, horizon = fallback.path, fallback.is_used, run.settings.horizon
    for agent in range(is_used.size):
        is_used[agent] = False
        path[agent, 0] = run.agents.position[agent]
        for t in range(1, path.shape[1]):
            cell = np.int64(plan[t, agent])
            path[agent, t] = cell if cell >= 0 else path[agent, t - 1]
            # Without a path from the beginning on, or one that ends too soon.
            is_used[agent] = is_used[agent] or (cell < 0 and t <= horizon)
        for other in range(0 if solved else agent):
            if _conflict(plan, agent, other, horizon):
                is_used[agent], is_used[other] = True, True


@formula
def _conflict(plan: np.ndarray, agent: int, other: int, horizon: int) -> bool:
    """Return True if two agents meet or swap cells within the driven steps."""
    found = False
    for t in range(1, horizon + 1):
        meets = plan[t, agent] == plan[t, other]
        swaps = plan[t, agent] == plan[t - 1, other] and plan[t - 1, agent] == plan[t, other]
        found = found or meets or swaps
    return found


@kernel
def solve(work: Workspace, fields: DistanceFields, grid: GridMap, seed: int) -> bool:
    """Search for paths without conflicts; returns whether they were found, in ``work.plan``.

    If not, ``work.tree.best`` is the plan whose first conflict is latest. If the arrays are too
    small ``work.tree.is_full`` is set, and nothing is right.
    """
    tree, plan, changes = work.tree, work.plan, work.changes
    if tree.num_dead_ends[()]:
        tree.dead_end[:] = False
    tree.is_full[()], tree.num_dead_ends[()], tree.best_time[()] = False, 0, -1
    last = _plan_root(work, fields, grid, seed)
    if last == INCONSISTENT:
        _keep_best(tree, plan, 0)
        return False
    first, depth, nodes = 0, 0, 0
    while True:
        if first == last:
            return True
        earliest, pick = _choose_conflict(tree, first, last)
        _keep_best(tree, plan, earliest)
        if nodes == work.node_limit or tree.is_full[()]:
            return False
        if depth == tree.node.shape[0]:
            tree.is_full[()] = True
            return False
        nodes += 1
        work.num_nodes[()] += 1
        _expand(work, fields, grid, seed, depth, pick, first, last)
        # Go back up until there is a child to search next, undoing the changes on the way.
        while tree.node[depth].num_entered == tree.node[depth].num_children:
            changes.num_changes[()] = tree.node[depth].num_changes
            tree.num_conflicts[()] = tree.node[depth].num_conflicts
            if depth == 0:
                return False
            depth -= 1
            child = tree.child[depth, tree.order[depth, tree.node[depth].num_entered - 1]]
            for change in range(child.end_change - 1, child.first_change - 1, -1):
                redo(plan, changes, change, OLD)
            take_back(work.order)
        child = tree.child[depth, tree.order[depth, tree.node[depth].num_entered]]
        tree.node[depth].num_entered += 1
        put_above(work.order, child.high, child.low)
        for change in range(child.first_change, child.end_change):
            redo(plan, changes, change, NEW)
        first, last = child.first_conflict, child.end_conflict
        depth += 1


@kernel
def _plan_root(work: Workspace, fields: DistanceFields, grid: GridMap, seed: int) -> int:
    """Plan all agents, one after the other; returns the number of conflicts.

    Nobody has precedence but those who are bound to their start.
    """
    plan, tree, queue, goals = work.plan, work.tree, work.queue, work.goals
    agents, window = queue.num_near.size, plan.cell.shape[0] - 1
    queue.num_near[:] = 0
    for agent in range(agents):
        for other in range(agent):
            rows = abs(goals.row[agent] - goals.row[other])
            # Two agents that go towards one another for the whole window.
            if rows + abs(goals.column[agent] - goals.column[other]) <= 2 * window:
                queue.near[agent, queue.num_near[agent]] = other
                queue.near[other, queue.num_near[other]] = agent
                queue.num_near[agent] += 1
                queue.num_near[other] += 1
    work.order.first[:] = NOBODY
    work.order.num_pairs[()] = 0
    # At first only those are anywhere whom a service keeps at their start: all know of them.
    plan.delay[()] = 0
    for agent in range(agents):
        last = min(goals.begin[agent], window)
        path = plan.path[agent]
        path.end, path.bound, path.delay = last, last + 1, 0
        for t in range(window + 1):
            plan.cell[t, agent] = goals.start[agent] if t <= last else -1 - agent
    tree.num_conflicts[()], work.changes.num_changes[()] = 0, 0
    for agent in range(agents):
        walk(work.order, agent, UP)
        if not replan(work, fields, grid, agent, seed):
            return INCONSISTENT
    last, waiting = 0, 0
    for agent in range(agents):
        find_conflicts(plan, agent)
        if last + agent > tree.conflict.size:
            tree.is_full[()] = True
            return INCONSISTENT
        waiting, last = note_conflicts(
            plan, work.order, queue, tree.conflict, agent, agent, waiting, last
        )
    last = resolve(work, fields, grid, seed, waiting, 0, last)
    work.changes.num_changes[()], tree.num_conflicts[()] = 0, max(last, 0)
    return last


@kernel
def _choose_conflict(tree: SearchTree, first: int, last: int) -> tuple[int, int]:
    """Choose the earliest conflict, but before it any whose agents had no feasible child once.

    Returns:
        The time of the earliest, the conflict chosen.
    """
    earliest, best, chosen = tree.conflict[first], _PREFERRED, tree.conflict[first]
    for index in range(first, last):
        pack = tree.conflict[index]
        earliest = min(earliest, pack)
        _, one, two = parts_of(pack)
        key = pack - _PREFERRED if tree.dead_end[one, two] else pack
        if key < best:
            best, chosen = key, pack
    return parts_of(earliest)[0], chosen


@kernel
def _keep_best(tree: SearchTree, plan: JointPlan, earliest: int) -> None:
    """Keep the plan if its first conflict is later than all before, or as late with less delay."""
    best, delay = tree.best_time[()], plan.delay[()]
    if earliest > best or (earliest == best and delay < tree.best_delay[()]):
        tree.best_time[()], tree.best_delay[()] = earliest, delay
        for t in range(plan.cell.shape[0]):
            for agent in range(plan.cell.shape[1]):
                tree.best[t, agent] = plan.cell[t, agent]


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
    tree, node, children = work.tree, work.tree.node[depth], work.tree.child[depth]
    _, one, two = parts_of(pick)
    node.num_changes, node.num_conflicts = work.changes.num_changes[()], tree.num_conflicts[()]
    node.num_children, node.num_entered = 0, 0
    for side in range(2):
        low, high = (one, two) if side == 0 else (two, one)
        walk(work.order, high, UP)
        if is_found(work.order, low, UP, work.order.walk[()]):
            continue
        children[side].low, children[side].high = low, high
        if _make_child(work, fields, grid, seed, depth, side, first, last):
            tree.order[depth, node.num_children] = side
            node.num_children += 1
    if node.num_children == 0:
        tree.dead_end[one, two] = True
        tree.num_dead_ends[()] += 1
    elif node.num_children == 2:
        many = children[0].end_conflict - children[0].first_conflict
        few = children[1].end_conflict - children[1].first_conflict
        more, less = children[0].cost, children[1].cost
        if less < more or (less == more and few <= many):
            tree.order[depth, 0], tree.order[depth, 1] = 1, 0


@kernel
def _make_child(
    work: Workspace,
    fields: DistanceFields,
    grid: GridMap,
    seed: int,
    depth: int,
    side: int,
    first: int,
    last: int,
) -> bool:
    """Make one child and write down what changes; returns whether it can be made consistent."""
    tree, changes, plan, queue = work.tree, work.changes, work.plan, work.queue
    child = tree.child[depth, side]
    begin, change = tree.num_conflicts[()], changes.num_changes[()]
    end = begin + last - first
    if end > tree.conflict.size:
        tree.is_full[()] = True
        return False
    for index in range(last - first):
        tree.conflict[begin + index] = tree.conflict[first + index]
    put_above(work.order, child.high, child.low)
    queue.waiting[0], queue.is_waiting[child.low] = child.low, True
    end = resolve(work, fields, grid, seed, 1, begin, end)
    child.cost = plan.delay[()]
    take_back(work.order)
    for index in range(changes.num_changes[()] - 1, change - 1, -1):
        redo(plan, changes, index, OLD)
    if end == INCONSISTENT:
        changes.num_changes[()] = change
        return False
    child.first_conflict, child.end_conflict = begin, end
    child.first_change, child.end_change = change, changes.num_changes[()]
    tree.num_conflicts[()] = end
    return True
