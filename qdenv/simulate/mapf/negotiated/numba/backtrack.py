"""Read a path backwards out of the states that a search visitd."""

from qdenv.grid import NUM_MOVES
from qdenv.native import formula, kernel
from qdenv.simulate.mapf.host.state import GridMap
from qdenv.simulate.mapf.negotiated import path_rules, rules
from qdenv.simulate.mapf.negotiated.numba.reservations import (
    ReservationWords,
    is_reserved,
    is_taken,
)
from qdenv.simulate.mapf.negotiated.numba.search import Agent, SearchArrays, is_marked
from qdenv.simulate.mapf.negotiated.path_rules import PathState


@kernel
def trace(
    work: SearchArrays,
    reservations: ReservationWords,
    grid: GridMap,
    agent: Agent,
    code: int,
    number: int,
) -> None:
    """Read the path that ends at `code` into the path of agent `number`."""
    window, state = work.mark.shape[0] - 1, path_rules.unpack_end(code, work.levels, work.side)
    if state.elapsed >= 0:  # in service: at the goal
        cell, middle = agent.cell[state.leg], work.side // 2
        row = rules.goal_row(cell, agent.position, grid.width, middle)
        column = rules.goal_column(cell, agent.position, grid.width, middle)
        state = PathState(state.leg, state.conflicts, row, column, state.elapsed)
    for t in range(window, -1, -1):
        reservations.path[number, t] = _cell(work, grid, agent, state)
        if t:
            state = _predecessor(work, reservations, grid, agent, state, t - 1)


@formula
def _cell(work: SearchArrays, grid: GridMap, agent: Agent, state: PathState[int]) -> int:
    """Find the cell of a state."""
    middle = work.side // 2
    return agent.position + (state.row - middle) * grid.width + state.column - middle


@formula
def _predecessor(
    work: SearchArrays,
    reservations: ReservationWords,
    grid: GridMap,
    agent: Agent,
    state: PathState[int],
    t: int,
) -> PathState[int]:
    """Go from where the path is at t + 1 to where it was at t."""
    on_first_goal = _cell(work, grid, agent, state) == agent.cell[0]
    served = work.served[state.conflicts, 0, t + 1]
    finished = rules.has_served(served, agent.service_time[0])
    if path_rules.is_entry(state, on_first_goal, finished):
        state = PathState(0, state.conflicts, state.row, state.column, agent.service_time[0])
    word = reservations.word[_cell(work, grid, agent, state)]
    if state.elapsed > 0:
        leg, conflicts, row, column, elapsed = state
        fewer = work.served[max(conflicts - 1, 0), leg, t]
        conflict = path_rules.service_conflict(
            conflicts, is_reserved(word, t), rules.has_served(fewer, elapsed - 1)
        )
        return PathState(leg, conflicts - conflict, row, column, elapsed - 1)
    return _drive_before(work, state, word, t, path_rules.is_flipped(agent.tie_break))


@formula
def _drive_before(
    work: SearchArrays, state: PathState[int], word: int, t: int, flipped: int
) -> PathState[int]:
    """Take the first neighbour, in order of preference, from which this cell was reached."""
    leg, conflicts, row, column, _ = state
    for rank in range(NUM_MOVES):
        move = path_rules.move_at(rank, flipped)
        i, j = path_rules.row_before(row, move), path_rules.column_before(column, move)
        if not rules.is_visible(i, j, work.side):
            continue
        place = i * work.side + j
        same = is_marked(work, t, place, leg, conflicts)
        fewer = is_marked(work, t, place, leg, conflicts - 1) if conflicts else 0
        conflicting = is_taken(word, t, move)
        if path_rules.is_predecessor(same, fewer, conflicting, conflicts == work.levels - 1):
            return PathState(leg, conflicts - (conflicting & fewer), i, j, -1)
    return PathState(leg, conflicts, row, column, -1)
