"""Read a path backwards out of the sets of cells that could be reached."""

import numpy as np

from qdenv.native import inlined
from qdenv.simulate.mapf.negotiated import path_rules, rules
from qdenv.simulate.mapf.negotiated.numba.observation import Agent, VisibleGoal, Workspace
from qdenv.simulate.mapf.negotiated.path_rules import PathState


@inlined
def trace(
    work: Workspace,
    agent: Agent,
    goals: tuple[VisibleGoal, VisibleGoal],
    code: int,
    path: np.ndarray,
) -> None:
    """Read the path that ends at `code` into `path` (int64 [w + 1], ``row * E + column``)."""
    levels, window, side = work.expandable.shape[0], path.size - 1, work.rows.shape[0]
    state = end_state(goals, code, levels, side)
    for t in range(window, 0, -1):
        path[t] = state.row * side + state.column
        state = predecessor(work, agent, goals, state, t - 1)
    path[0] = state.row * side + state.column


@inlined
def end_state(
    goals: tuple[VisibleGoal, VisibleGoal], code: int, levels: int, side: int
) -> PathState[int]:
    """Find the end of the path that the search chose."""
    state = path_rules.unpack_end(code, levels, side)
    if state.elapsed < 0:
        return state
    goal = goals[state.leg]
    return PathState(state.leg, state.conflicts, goal.row, goal.column, state.elapsed)


@inlined
def predecessor(
    work: Workspace,
    agent: Agent,
    goals: tuple[VisibleGoal, VisibleGoal],
    state: PathState[int],
    t: int,
) -> PathState[int]:
    """Go from where the path is at t + 1 to where it was at t."""
    leg, conflicts, row, column, elapsed = state
    on_first_goal = row == goals[0].row and column == goals[0].column
    service_time = agent.service_time[0]
    finished = rules.has_served(work.served[conflicts, 0, t + 1], service_time)
    if path_rules.is_entry(state, on_first_goal, finished):
        leg, elapsed = 0, service_time
    state = PathState(leg, conflicts, row, column, elapsed)
    if elapsed > 0:
        return serve_before(work, state, t)
    return drive_before(work, state, t, path_rules.is_flipped(agent.noise))


@inlined
def serve_before(work: Workspace, state: PathState[int], t: int) -> PathState[int]:
    """Serve for one timestep less."""
    leg, conflicts, row, column, elapsed = state
    disturbed = work.conflicting[t, work.rows[row, 0], 0] >> (work.rows[row, 1] + column) & 1
    fewer = work.served[max(conflicts - 1, 0), leg, t]
    conflict = path_rules.service_conflict(
        conflicts, disturbed, rules.has_served(fewer, elapsed - 1)
    )
    return PathState(leg, conflicts - conflict, row, column, elapsed - 1)


@inlined
def drive_before(work: Workspace, state: PathState[int], t: int, flipped: int) -> PathState[int]:
    """Take the first neighbour, in order of preference, from which this cell was reached."""
    leg, conflicts, row, column, _ = state
    levels, side = work.expandable.shape[0], work.rows.shape[0]
    planes, shift = work.conflicting[t, work.rows[row, 0]], work.rows[row, 1] + column
    for rank in range(rules.MOVES):
        move = path_rules.move_at(rank, flipped)
        i, j = path_rules.row_before(row, move), path_rules.column_before(column, move)
        if not rules.is_visible(i, j, side):
            continue
        word, bit = work.rows[i, 0], work.rows[i, 1] + j
        same = work.expandable[conflicts, leg, t, word] >> bit & 1
        fewer = work.expandable[conflicts - 1, leg, t, word] >> bit & 1 if conflicts else 0
        conflicting = planes[move] >> shift & 1
        if path_rules.is_predecessor(same, fewer, conflicting, conflicts == levels - 1):
            return PathState(leg, conflicts - (conflicting & fewer), i, j, -1)
    return PathState(leg, conflicts, row, column, -1)
