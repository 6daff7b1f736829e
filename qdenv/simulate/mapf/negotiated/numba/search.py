"""The best path of one agent through a window, past the reservations of the others.

The same search as `xla.search`, bit for bit, one conflict level after the other. Levels that
cannot pay are left out: those where even the best possible path would cost more than the one
found. `observation` explains the arrays.
"""

from typing import NamedTuple

import numpy as np

from qdenv.native import compiled, inlined
from qdenv.simulate.mapf.negotiated import path_rules, rules
from qdenv.simulate.mapf.negotiated.numba.backtrack import trace
from qdenv.simulate.mapf.negotiated.numba.observation import (
    BITS,
    Agent,
    Grid,
    VisibleGoal,
    Workspace,
    find_goal,
    gather,
)
from qdenv.simulate.mapf.negotiated.numba.reservations import Reservations


class Task(NamedTuple):
    """What the agent wants, as the search sees it.

    Attributes:
        goals: where the goals of both legs are in sight.
        earliest: timestep before which the current goal cannot be done.
        after: cost of what follows the goal of each leg.
        corner: the cell in sight farthest up and left.
    """

    goals: tuple[VisibleGoal, VisibleGoal]
    earliest: int
    after: tuple[int, int]
    corner: int


@compiled
def find_path(
    work: Workspace, reservations: Reservations, grid: Grid, agent: Agent, path: np.ndarray
) -> bool:
    """Find the best path of one agent; returns whether there is any.

    Args:
        work: to work in.
        reservations: of the others.
        grid: the layout.
        agent: who plans.
        path: int64 [w + 1], receives the path.
    """
    levels, window = work.expandable.shape[0], work.conflicting.shape[0]
    gather(work, reservations, grid, agent.position)
    task = see_task(work, grid, agent)
    # No path can get more done within the window than to drive straight on.
    least = path_rules.driving_cost(task.earliest - window, 0, task.after[0])
    best = path_rules.INFEASIBLE
    for conflicts in range(levels):
        start(work, agent, conflicts)
        reach(work, agent, task, conflicts)
        best = cheapest_end(work, grid, agent, task, conflicts, best)
        if best >> path_rules.CODE_BITS < path_rules.f_cost(least, conflicts + 1, agent.penalty):
            break  # a path with more conflicts costs more, whatever it is
    found = best < path_rules.INFEASIBLE
    code = (best ^ path_rules.tie_breaker(agent.noise)) & path_rules.CODES if found else 0
    trace(work, agent, task.goals, code, path)
    for t in range(window + 1):  # from rows and columns in sight to cells
        row, column = path[t] // work.rows.shape[0], path[t] % work.rows.shape[0]
        path[t] = task.corner + row * grid.width + column
    return found


@inlined
def see_task(work: Workspace, grid: Grid, agent: Agent) -> Task:
    """Find the goals in sight and price what follows them."""
    window, (slot, next_slot) = work.conflicting.shape[0], agent.goal
    between = int(grid.distance[next_slot, grid.goals[slot]])
    after = path_rules.cost_after_goal(between, agent.service_time[1])
    earliest = agent.remaining_service
    if earliest == 0:
        earliest = int(grid.distance[slot, agent.position]) + agent.service_time[0]
    goals = find_goal(work, grid, agent, 0), find_goal(work, grid, agent, 1)
    return Task(goals, earliest, (after, 0), agent.position - window * grid.width - window)


@inlined
def start(work: Workspace, agent: Agent, conflicts: int) -> None:
    """Set what is reached before the first step: the middle, or the service under way."""
    work.expandable[conflicts] = 0
    work.served[conflicts, :, 0] = 0
    if conflicts == 0 and agent.remaining_service:
        work.served[0, 0, 0] = 1 << (agent.service_time[0] - agent.remaining_service)
    elif conflicts == 0:
        middle = work.rows.shape[0] // 2
        work.expandable[0, 0, 0, work.rows[middle, 0]] = 1 << (work.rows[middle, 1] + middle)


@inlined
def reach(work: Workspace, agent: Agent, task: Task, conflicts: int) -> None:
    """Fill one conflict level, those below being filled: what is expandable at every timestep."""
    first_goal = task.goals[0]
    for t in range(work.conflicting.shape[0]):
        just_served = 0
        for leg in range(2):
            goal, cells = task.goals[leg], work.expandable[conflicts, leg, t + 1]
            if leg == 0 or t >= task.earliest:
                drive(work, t, leg, conflicts)
            arrived = cells[goal.word] & goal.bit != 0
            cells[goal.word] = rules.expandable(cells[goal.word], goal.bit, 0, 0)
            serve(work, goal, t, leg, conflicts, arrived)
            if leg == 0:
                served = work.served[conflicts, 0, t + 1]
                just_served = -rules.has_served(served, agent.service_time[0])
            else:
                here = cells[first_goal.word]
                cells[first_goal.word] = rules.expandable(here, 0, just_served, first_goal.bit)


@inlined
def serve(
    work: Workspace, goal: VisibleGoal, t: int, leg: int, conflicts: int, arrived: bool
) -> None:
    """Continue the service at a goal from t to t + 1, and begin it on arrival."""
    levels = work.served.shape[0]
    served = work.served[conflicts, leg, t]
    fewer = work.served[conflicts - 1, leg, t] if conflicts else 0
    disturbed = -1 if work.conflicting[t, goal.word, 0] & goal.bit else 0
    cap = -1 if conflicts == levels - 1 else 0
    longer = rules.continue_service(served, fewer, disturbed, cap)
    work.served[conflicts, leg, t + 1] = rules.begin_service(longer, 1 if arrived else 0)


@inlined
def drive(work: Workspace, t: int, leg: int, conflicts: int) -> None:
    """Take one timestep within one leg and conflict level, in the words that can be reached."""
    side, window, levels = work.rows.shape[0], work.conflicting.shape[0], work.served.shape[0]
    source, target = work.expandable[conflicts, leg, t], work.expandable[conflicts, leg, t + 1]
    clashing = work.clashing[conflicts, leg, t + 1]
    fewer_clashing = work.clashing[max(conflicts - 1, 0), leg, t + 1]
    has_fewer, cap = -1 if conflicts else 0, -1 if conflicts == levels - 1 else 0
    # Several rows share a word: a step to the side must not end in the row above or below.
    left_edge = 0
    for row in range(BITS // side):
        left_edge |= 1 << (row * side)
    not_left, not_right = ~left_edge, ~(left_edge << (side - 1))
    top, one_row = (BITS // side - 1) * side, (1 << side) - 1
    for i in range(work.rows[window - t - 1, 0], work.rows[window + t + 1, 0] + 1):
        here = source[i]
        right, left = (here << 1) & not_left, (here >> 1) & not_right
        down = (here << side) | (source[i - 1] >> top)
        up = (here >> side) | ((source[i + 1] & one_row) << top)
        planes = work.conflicting[t, i]
        clean, clash = rules.arrivals(
            (here, right, left, down, up),
            (planes[0], planes[1], planes[2], planes[3], planes[4]),
            work.traversable[i],
        )
        clashing[i] = clash
        target[i] = rules.count_conflict(clean, clash, fewer_clashing[i] & has_fewer, cap)


@inlined
def cheapest_end(
    work: Workspace, grid: Grid, agent: Agent, task: Task, conflicts: int, best: int
) -> int:
    """Find the cheapest end within one conflict level; returns its key, or `best` if smaller."""
    levels, side = work.expandable.shape[0], work.rows.shape[0]
    tie = path_rules.tie_breaker(agent.noise)
    for leg in range(2):
        service_time, after = agent.service_time[leg], task.after[leg]
        cells = work.expandable[conflicts, leg, -1]
        for i in range(side):
            bits = (cells[work.rows[i, 0]] >> work.rows[i, 1]) & ((1 << side) - 1)
            if bits == 0:
                continue
            begin = task.corner + i * grid.width
            distance = grid.distance[agent.goal[leg], begin : begin + side]
            for j in range(side):  # without a branch, so that it runs on vectors
                cost = path_rules.driving_cost(int(distance[j]), service_time, after)
                cost = path_rules.f_cost(cost, conflicts, agent.penalty)
                code = path_rules.driving_end(leg, conflicts, levels, i, j, side)
                key = path_rules.end_key(cost, code, tie)
                best = min(best, key if (bits >> j) & 1 else path_rules.INFEASIBLE)
        served, elapsed = work.served[conflicts, leg, -1], 0
        while served >> elapsed:
            if rules.has_served(served, elapsed):
                cost = path_rules.serving_cost(service_time, elapsed, after)
                cost = path_rules.f_cost(cost, conflicts, agent.penalty)
                code = path_rules.serving_end(leg, conflicts, levels, elapsed, side)
                best = min(best, path_rules.end_key(cost, code, tie))
            elapsed += 1
    return best
