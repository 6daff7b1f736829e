"""Priority-based search: a tree of partial orders, searched depth first.

Ma et al. 2019, "Searching with consistent prioritization for multi-agent path finding",
https://arxiv.org/abs/1812.06356, algorithm 1; for windows, Li et al. 2021,
https://arxiv.org/abs/2005.07371. A node is a partial order of the agents with a path for each that
avoids those of everybody above it. While two agents conflict, one child puts the first above the
second and the other the reverse; the one with the shorter paths is searched first, of equals the
one with fewer conflicts.

Only the node in hand is kept as a whole. The others are the changes that lead there, and their
conflicts: so a node costs what it changes.
"""

from qdenv.native import kernel
from qdenv.simulate.mapf.host.fields import Fields
from qdenv.simulate.mapf.host.site import Site
from qdenv.simulate.mapf.pbs.plans import (
    NEW,
    OLD,
    Plan,
    be_nowhere,
    find_conflicts,
    parts_of,
    redo,
)
from qdenv.simulate.mapf.pbs.priorities import (
    MARK,
    UP,
    forget_priorities,
    is_found,
    put_above,
    take_back,
    walk,
)
from qdenv.simulate.mapf.pbs.replan import list_near, replan
from qdenv.simulate.mapf.pbs.settle import INCONSISTENT, note_conflicts, settle
from qdenv.simulate.mapf.pbs.workspace import (
    CONFLICTS,
    DEAD_ENDS,
    FAILED,
    NODES,
    WANTED,
    Tree,
    Workspace,
)

PREFERRED = 1 << 60  # taken off a conflict that comes first
FIRST, PAST = 0, 1
CHANGE, CLASH = 0, 1
CHILDREN, ENTERED = 0, 1


@kernel
def solve(work: Workspace, fields: Fields, site: Site, seed: int) -> bool:
    """Search for paths without conflicts; returns whether they were found, in ``work.plan``.

    If not, ``work.tree.best`` is the plan whose first conflict is latest. Where room was wanting
    ``work.tree.number[WANTED]`` is set, and nothing is right.
    """
    tree, plan = work.tree, work.plan
    if tree.number[DEAD_ENDS]:
        tree.dead_end[:] = False
    tree.number[WANTED], tree.number[DEAD_ENDS], tree.score[0] = 0, 0, -1
    last = plan_root(work, fields, site, seed)
    if last == INCONSISTENT:
        keep_best(tree, plan, 0)
        return False
    first, depth, nodes = 0, 0, 0
    while True:
        if first == last:
            return True
        earliest, pick = choose_conflict(tree, first, last)
        keep_best(tree, plan, earliest)
        if nodes == work.terms.node_limit or tree.number[WANTED]:
            return False
        if depth == tree.cost.shape[0]:
            tree.number[WANTED] = 1
            return False
        nodes += 1
        work.tally[NODES] += 1
        expand(work, fields, site, seed, depth, pick, (first, last))
        while tree.children[depth, ENTERED] == tree.children[depth, CHILDREN]:
            work.changes.made[0] = tree.base[depth, CHANGE]
            tree.number[CONFLICTS] = tree.base[depth, CLASH]
            if depth == 0:
                return False
            depth -= 1
            leave(work, depth)
        child = enter(work, depth)
        first, last = tree.clash[depth, child, FIRST], tree.clash[depth, child, PAST]
        depth += 1


@kernel
def plan_root(work: Workspace, fields: Fields, site: Site, seed: int) -> int:
    """Plan everybody by itself, one after the other; returns how many conflicts there are.

    Nobody has precedence but those who are bound to their start.
    """
    plan, tree, crowd = work.plan, work.tree, work.crowd
    list_near(work)
    forget_priorities(work.order)
    be_nowhere(plan, work.errands)
    tree.number[CONFLICTS], work.changes.made[0] = 0, 0
    for agent in range(crowd.nears.size):
        walk(work.order, agent, UP)
        if not replan(work, fields, site, agent, seed):
            return INCONSISTENT
    last, waiting = 0, 0
    for agent in range(crowd.nears.size):
        find_conflicts(plan, agent)
        if last + agent > tree.conflict.size:
            tree.number[WANTED] = 1
            return INCONSISTENT
        waiting, last = note_conflicts(
            plan, work.order, crowd, tree.conflict, agent, agent, waiting, last
        )
    last = settle(work, fields, site, seed, waiting, 0, last)
    work.changes.made[0], tree.number[CONFLICTS] = 0, max(last, 0)
    return last


@kernel
def choose_conflict(tree: Tree, first: int, last: int) -> tuple[int, int]:
    """Choose the earliest conflict, but before it any whose agents had no feasible child once.

    Returns:
        the time of the earliest, the conflict chosen.
    """
    earliest, best, chosen = tree.conflict[first], PREFERRED, tree.conflict[first]
    for index in range(first, last):
        pack = tree.conflict[index]
        earliest = min(earliest, pack)
        _, one, two = parts_of(pack)
        key = pack - PREFERRED if tree.dead_end[one, two] else pack
        if key < best:
            best, chosen = key, pack
    return parts_of(earliest)[0], chosen


@kernel
def keep_best(tree: Tree, plan: Plan, earliest: int) -> None:
    """Keep the plan if its first conflict is later than all before, or of these it delays less."""
    score, delay = tree.score, plan.total[0]
    if earliest > score[0] or (earliest == score[0] and delay < score[1]):
        score[0], score[1] = earliest, delay
        for t in range(plan.cell.shape[0]):
            for agent in range(plan.cell.shape[1]):
                tree.best[t, agent] = plan.cell[t, agent]


@kernel
def expand(
    work: Workspace,
    fields: Fields,
    site: Site,
    seed: int,
    depth: int,
    pick: int,
    conflicts: tuple[int, int],
) -> None:
    """Make the children of a node, which is in hand before and after."""
    tree, changes = work.tree, work.changes
    _, one, two = parts_of(pick)
    tree.base[depth, CHANGE], tree.base[depth, CLASH] = changes.made[0], tree.number[CONFLICTS]
    tree.children[depth, CHILDREN], tree.children[depth, ENTERED] = 0, 0
    for child in range(2):
        low, high = (one, two) if child == 0 else (two, one)
        walk(work.order, high, UP)
        if is_found(work.order, low, UP, work.order.number[MARK]):
            continue
        if make_child(work, fields, site, seed, (depth, child, low, high), conflicts):
            tree.turn[depth, tree.children[depth, CHILDREN]] = child
            tree.children[depth, CHILDREN] += 1
        else:
            work.tally[FAILED] += 1
    if tree.children[depth, CHILDREN] == 0:
        tree.dead_end[one, two] = True
        tree.number[DEAD_ENDS] += 1
    elif tree.children[depth, CHILDREN] == 2:
        costs, clash = tree.cost[depth], tree.clash[depth]
        many, few = clash[0, PAST] - clash[0, FIRST], clash[1, PAST] - clash[1, FIRST]
        if costs[1] < costs[0] or (costs[1] == costs[0] and few <= many):
            tree.turn[depth, 0], tree.turn[depth, 1] = 1, 0


@kernel
def make_child(
    work: Workspace,
    fields: Fields,
    site: Site,
    seed: int,
    child: tuple[int, int, int, int],
    conflicts: tuple[int, int],
) -> bool:
    """Make one child and write down what changes; returns whether it can be made consistent."""
    tree, changes, plan, crowd = work.tree, work.changes, work.plan, work.crowd
    depth, side, low, high = child
    first, change = tree.number[CONFLICTS], changes.made[0]
    last = first + conflicts[1] - conflicts[0]
    if last > tree.conflict.size:
        tree.number[WANTED] = 1
        return False
    for index in range(last - first):
        tree.conflict[first + index] = tree.conflict[conflicts[0] + index]
    put_above(work.order, high, low)
    crowd.waiting[0], crowd.is_waiting[low] = low, True
    last = settle(work, fields, site, seed, 1, first, last)
    cost = plan.total[0]
    take_back(work.order)
    for index in range(changes.made[0] - 1, change - 1, -1):
        redo(plan, changes, index, OLD)
    if last == INCONSISTENT:
        changes.made[0] = change
        return False
    tree.low[depth, side], tree.high[depth, side], tree.cost[depth, side] = low, high, cost
    tree.clash[depth, side, FIRST], tree.clash[depth, side, PAST] = first, last
    tree.change[depth, side, FIRST], tree.change[depth, side, PAST] = change, changes.made[0]
    tree.number[CONFLICTS] = last
    return True


@kernel
def enter(work: Workspace, depth: int) -> int:
    """Go down to the next child of a node; returns which one it is."""
    tree = work.tree
    child = tree.turn[depth, tree.children[depth, ENTERED]]
    tree.children[depth, ENTERED] += 1
    put_above(work.order, tree.high[depth, child], tree.low[depth, child])
    for change in range(tree.change[depth, child, FIRST], tree.change[depth, child, PAST]):
        redo(work.plan, work.changes, change, NEW)
    return child


@kernel
def leave(work: Workspace, depth: int) -> None:
    """Go back up from the child that was entered last to its parent."""
    tree = work.tree
    child = tree.turn[depth, tree.children[depth, ENTERED] - 1]
    for change in range(
        tree.change[depth, child, PAST] - 1, tree.change[depth, child, FIRST] - 1, -1
    ):
        redo(work.plan, work.changes, change, OLD)
    take_back(work.order)
