"""Read a path backwards out of the states that a search visited."""

from qdenv.native import formula, kernel
from qdenv.simulate.mapf.host.site import Site
from qdenv.simulate.mapf.negotiated import path_rules, rules
from qdenv.simulate.mapf.negotiated.numba.reservations import Reservations, is_reserved, is_taken
from qdenv.simulate.mapf.negotiated.numba.states import Agent, Workspace, is_marked
from qdenv.simulate.mapf.negotiated.path_rules import PathState


@kernel
def trace(
    work: Workspace,
    reservations: Reservations,
    site: Site,
    agent: Agent,
    code: int,
    number: int,
) -> None:
    """Read the path that ends at `code` into the path of agent `number`."""
    window, state = work.mark.shape[0] - 1, _end_state(work, site, agent, code)
    for t in range(window, -1, -1):
        reservations.path[number, t] = _cell(work, site, agent, state)
        if t:
            state = _predecessor(work, reservations, site, agent, state, t - 1)


@formula
def _cell(work: Workspace, site: Site, agent: Agent, state: PathState[int]) -> int:
    """Find the cell of a state."""
    middle = work.side // 2
    return agent.position + (state.row - middle) * site.width + state.column - middle


@formula
def _end_state(work: Workspace, site: Site, agent: Agent, code: int) -> PathState[int]:
    """Find the end of the path that the search chose."""
    state = path_rules.unpack_end(code, work.levels, work.side)
    if state.elapsed < 0:
        return state
    window, cell = work.side // 2, agent.cell[state.leg]
    row = rules.goal_row(cell, agent.position, site.width, window)
    column = rules.goal_column(cell, agent.position, site.width, window)
    return PathState(state.leg, state.conflicts, row, column, state.elapsed)


@formula
def _predecessor(
    work: Workspace,
    reservations: Reservations,
    site: Site,
    agent: Agent,
    state: PathState[int],
    t: int,
) -> PathState[int]:
    """Go from where the path is at t + 1 to where it was at t."""
    on_first_goal = _cell(work, site, agent, state) == agent.cell[0]
    served = work.served[state.conflicts, 0, t + 1]
    finished = rules.has_served(served, agent.service_time[0])
    if path_rules.is_entry(state, on_first_goal, finished):
        state = PathState(0, state.conflicts, state.row, state.column, agent.service_time[0])
    word = reservations.word[_cell(work, site, agent, state)]
    if state.elapsed > 0:
        return _serve_before(work, state, word, t)
    return _drive_before(work, state, word, t, path_rules.is_flipped(agent.noise))


@formula
def _serve_before(work: Workspace, state: PathState[int], word: int, t: int) -> PathState[int]:
    """Serve for one timestep less."""
    leg, conflicts, row, column, elapsed = state
    fewer = work.served[max(conflicts - 1, 0), leg, t]
    conflict = path_rules.service_conflict(
        conflicts, is_reserved(word, t), rules.has_served(fewer, elapsed - 1)
    )
    return PathState(leg, conflicts - conflict, row, column, elapsed - 1)


@formula
def _drive_before(
    work: Workspace, state: PathState[int], word: int, t: int, flipped: int
) -> PathState[int]:
    """Take the first neighbour, in order of preference, from which this cell was reached."""
    leg, conflicts, row, column, _ = state
    for rank in range(rules.MOVES):
        move = path_rules.move_at(rank, flipped)
        i, j = path_rules.row_before(row, move), path_rules.column_before(column, move)
        if not (rules.is_visible(i, j, work.side)):
            continue
        place = i * work.side + j
        same = is_marked(work, t, place, leg, conflicts)
        fewer = is_marked(work, t, place, leg, conflicts - 1) if conflicts else 0
        conflicting = is_taken(word, t, move)
        if path_rules.is_predecessor(same, fewer, conflicting, conflicts == work.levels - 1):
            return PathState(leg, conflicts - (conflicting & fewer), i, j, -1)
    return PathState(leg, conflicts, row, column, -1)
