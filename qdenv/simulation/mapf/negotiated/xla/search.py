"""The best path of one agent through a window, given what the others have reserved.

Every set of cells is a square of bits around the agent, one word per row. Which cells can be
reached at time t + 1 follows from those at time t by shifting words. The sets are separate by
leg and by the number of conflicts (`rules`); a *mask* is a word that is all ones or empty.

Only the end of a path has a cost: the steps still to go from there, plus a penalty per conflict.
The path itself is read off backwards: which neighbour was expandable one step before?
Where moves have costs, numbers take the place of sets (`LeastCosts`): what is a bit of a set is
then what the cheapest path has cost so far, by which a path is read off backwards.

While an agent serves at a goal it is in no set; bit e of `served` says that a path exists by which
it has been serving for e timesteps.
"""

from collections.abc import Iterator
from functools import partial
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp

from qdenv.grid import NUM_MOVES
from qdenv.simulation.mapf.negotiated import rules
from qdenv.simulation.mapf.negotiated.rules import PathState
from qdenv.simulation.mapf.negotiated.xla.window import ALL, FAR, LocalWindow, conflicting_cells

# Of K paths: where they are, and what they have cost so far (int32 [K], 0 without costs of moves).
_Paths: TypeAlias = tuple[PathState[jax.Array], jax.Array]


class ReachableSet(NamedTuple):
    """What can be reached at one timestep; the axes are conflicts (L levels), leg, row, agent.

    The order matters for speed: whole levels and rows move as blocks, agents lie side by side.
    """

    cells: jax.Array  # uint32 [L, 2, E, K], reached by driving, goals included
    served: jax.Array  # uint32 [L, 2, K], bit e: serving for e timesteps
    # uint32 [L, 2, 1, K], mask: service just ended on leg 1; on leg 0, the agent begins on its goal
    just_served: jax.Array


def _expandable(local: LocalWindow, reached: ReachableSet) -> jax.Array:
    """List the cells that paths go on from (uint32 [L, 2, E, K]).

    A goal is left only after service, on the next leg.
    """
    return (reached.cells & ~local.goal) | (reached.just_served & local.goal[:1])


class LeastCosts(NamedTuple):
    """What the cheapest paths at one timestep have cost, by conflicts (L levels) and leg."""

    cells: jax.Array  # int32 [L, 2, E, E, K], of paths that go on from a cell
    served: jax.Array  # int32 [L, 2, elapsed, K], of paths in service


def _by_conflicts(
    clean: jax.Array, conflicting: jax.Array, join: Any = jnp.bitwise_or, nothing: int = 0
) -> jax.Array:
    """Give each conflict level (axis 0) what a step with a further conflict or without leads to.

    Paths with one more come from the level below; the last level keeps its own.
    """
    levels = clean.shape[0]
    cap = (jnp.arange(levels) == levels - 1).reshape(-1, *[1] * (clean.ndim - 1))
    below = jnp.concatenate([jnp.full_like(conflicting[:1], nothing), conflicting[:-1]])
    return join(join(clean, below), jnp.where(cap, conflicting, nothing))


def _start(local: LocalWindow, levels: int) -> ReachableSet:
    """Set what is reached before the first step: the middle, or the service under way."""
    agents, side = local.penalty.shape[0], local.side
    middle, driving = side // 2, local.remaining_service == 0
    here = jnp.where(driving, jnp.uint32(1 << middle), 0)
    elapsed = (local.service_time[0] - local.remaining_service).astype(jnp.uint32)
    cells = jnp.zeros((levels, 2, side, agents), jnp.uint32)
    cells = cells.at[0, local.leg, middle, jnp.arange(agents)].set(here)
    served = jnp.zeros((levels, 2, agents), jnp.uint32)
    served = served.at[0, 0].set(jnp.where(driving, 0, jnp.uint32(1) << elapsed))
    # Standing on the goal is not arriving: the path leaves it like any other cell.
    on_goal = driving & (local.leg == 0) & ((local.goal[0, middle] >> middle) & 1 == 1)
    just_served = jnp.zeros((levels, 2, 1, agents), jnp.uint32)
    just_served = just_served.at[0, 0, 0].set(jnp.where(on_goal, jnp.uint32(ALL), 0))
    return ReachableSet(cells, served, just_served)


def _advance(
    local: LocalWindow, reached: ReachableSet, reserved: jax.Array, disturbed: jax.Array
) -> ReachableSet:
    """Take one timestep past its reservations (uint32 [5, E, K]): drive, arrive, serve.

    `disturbed` (uint32 [2, K]) is the mask of goals that another agent has reserved.
    """
    here = _expandable(local, reached)
    edge = jnp.zeros_like(here[:, :, :1])
    down = jnp.concatenate([edge, here[:, :, :-1]], axis=2)
    up = jnp.concatenate([here[:, :, 1:], edge], axis=2)
    clean, conflicting = jnp.zeros_like(here), jnp.zeros_like(here)
    moved = (here, here << 1, here >> 1, down, up)
    for arriving, taken in zip(moved, conflicting_cells(reserved), strict=True):
        clean, conflicting = clean | (arriving & ~taken), conflicting | (arriving & taken)
    cells = _by_conflicts(clean & local.traversable, conflicting & local.traversable)
    longer = reached.served << 1
    served = _by_conflicts(longer & ~disturbed, longer & disturbed)
    level, leg, agent = jnp.ogrid[: cells.shape[0], :2, : cells.shape[-1]]
    on_goal = cells[level, leg, local.goal_row, agent] & local.goal[leg, local.goal_row, agent]
    served = served | ((on_goal >> local.goal_column.astype(jnp.uint32)) & 1)
    done = (served[:, 0] >> local.service_time[0].astype(jnp.uint32)) & 1
    just_served = jnp.stack([jnp.zeros_like(done), -done], axis=1)[:, :, None]
    return ReachableSet(cells, served, just_served)


def _start_costs(local: LocalWindow, levels: int) -> LeastCosts:
    """Set what `_start` sets, where moves have costs."""
    agents, side, middle = local.penalty.shape[0], local.side, local.side // 2
    driving = local.remaining_service == 0
    elapsed = local.service_time[0] - local.remaining_service
    # Standing on the goal is not arriving: the path leaves it like any other cell.
    here = jnp.where(driving, 0, FAR)
    cells = jnp.full((levels, 2, side, side, agents), FAR, jnp.int32)
    serving = ~driving & (jnp.arange(rules.SERVED_BITS)[:, None] == elapsed)
    served = jnp.full((levels, 2, rules.SERVED_BITS, agents), FAR, jnp.int32)
    return LeastCosts(
        cells.at[0, local.leg, middle, middle, jnp.arange(agents)].set(here),
        served.at[0, 0].set(jnp.where(serving, 0, FAR)),
    )


def _advance_costs(
    local: LocalWindow, least: LeastCosts, reserved: jax.Array, disturbed: jax.Array
) -> LeastCosts:
    """Take one timestep as `_advance` does, where moves have costs."""
    assert local.costs is not None
    clean = conflicting = jnp.full_like(least.cells, FAR)
    moves = zip(local.costs, conflicting_cells(reserved), strict=True)
    for move, (price, taken) in enumerate(moves):
        # Around the border is no way: paths get there in the last step only.
        row, column = rules.cell_before(0, 0, move)
        after = jnp.roll(least.cells + price, (-row, -column), (2, 3))
        is_taken = _cells_of(taken)
        clean = jnp.minimum(clean, jnp.where(is_taken, FAR, after))
        conflicting = jnp.minimum(conflicting, jnp.where(is_taken, after, FAR))
    arrived = jnp.minimum(_by_conflicts(clean, conflicting, jnp.minimum, FAR), FAR)
    arrived = jnp.where(_cells_of(local.traversable), arrived, FAR)
    leg, elapsed, agent = jnp.ogrid[:2, : least.served.shape[2], : least.served.shape[3]]
    longer = least.served + local.staying_cost(leg, elapsed, agent)
    longer = jnp.roll(longer, 1, 2).at[:, :, 0].set(FAR)
    mask = disturbed[:, None] != 0
    clean, conflicting = jnp.where(mask, FAR, longer), jnp.where(mask, longer, FAR)
    served = _by_conflicts(clean, conflicting, jnp.minimum, FAR)
    on_goal = _cells_of(local.goal)
    begun = jnp.where(on_goal, arrived, FAR).min((2, 3))
    served = jnp.minimum(served, FAR).at[:, :, 0].set(begun)
    done = served[:, 0, local.service_time[0], agent[0, 0]]
    cells = jnp.where(on_goal, FAR, arrived)  # a goal is left only after service, on the next leg
    onwards = jnp.where(on_goal[0], done[:, None, None], FAR)
    return LeastCosts(cells.at[:, 1].min(onwards), served)


def _cells_of(words: jax.Array) -> jax.Array:
    """Unpack words (uint32 [..., E, K]) to one truth per cell (bool [..., E, E, K])."""
    column = jnp.arange(words.shape[-2], dtype=jnp.uint32)[:, None]
    return (words[..., None, :] >> column) & 1 == 1


def _ends(
    local: LocalWindow, cells: jax.Array, served: jax.Array
) -> Iterator[tuple[jax.Array, jax.Array, jax.Array]]:
    """List where a path can end: is it reached, its cost less `shortest`, its code."""
    levels, side, (unit, _) = cells.shape[0], local.side, rules.units(int(local.costs is not None))
    row, column = jnp.arange(side)[:, None, None], jnp.arange(side)[:, None]
    elapsed = jnp.arange(rules.SERVED_BITS)[:, None]
    for leg in range(2):
        after = (1 - leg) * local.cost_after_goal - local.shortest
        service_cost = unit * jnp.maximum(local.service_time[leg] - elapsed, 0) + after
        for conflicts in range(levels):
            price = conflicts * local.penalty
            here, serving = cells[conflicts, leg], served[conflicts, leg]
            code = rules.driving_end(leg, conflicts, levels, row, column, side)
            later = rules.serving_end(leg, conflicts, levels, elapsed, side)
            if local.costs is None:
                is_here = (here[:, None] >> column.astype(jnp.uint32)) & 1 == 1
                yield is_here, local.cost_to_go[leg] + price, code
                is_here = (serving >> elapsed.astype(jnp.uint32)) & 1 == 1
                yield is_here, service_cost + price, later
            else:
                yield here < FAR, here + local.cost_to_go[leg] + price, code
                yield serving < FAR, serving + service_cost + price, later


def _cheapest_end(
    local: LocalWindow, cells: jax.Array, served: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Choose where to be after the window (cost and code, both int32 [K]).

    `cells` are those that paths go on from at the end, `served` what has been served then
    (`ReachableSet`, or `LeastCosts`).
    """
    tie = local.tie_break & rules.CODES
    nothing = jnp.full(tie.shape, rules.INFEASIBLE, jnp.int32)

    def smallest(best: jax.Array, is_here: jax.Array, key: jax.Array) -> jax.Array:
        key = jnp.where(is_here, key, rules.INFEASIBLE)
        return jnp.minimum(best, key.min(tuple(range(key.ndim - 1))))

    best = nothing
    if local.costs is None:
        for is_here, cost, code in _ends(local, cells, served):
            # Cost and code in one number: the smallest is the best end, ties fall by chance.
            best = smallest(best, is_here, (cost << rules.CODE_BITS) | (code ^ tie))
        found, code, cost = best < rules.INFEASIBLE, best, best >> rules.CODE_BITS
    else:
        # Such costs have no room beside a code.
        for is_here, cost, _ in _ends(local, cells, served):
            best = smallest(best, is_here, cost)
        found, code, cost = best < rules.INFEASIBLE, nothing, best
        for is_here, cost_here, each in _ends(local, cells, served):
            code = smallest(code, is_here & (cost_here == best), each ^ tie)
    code = jnp.where(found, (code ^ tie) & rules.CODES, 0)
    return jnp.where(found, cost + local.shortest, rules.INFEASIBLE), code


def _is_in(words: jax.Array, column: jax.Array, side: int) -> jax.Array:
    """Return True where a word (uint32 [K]) has the bit of its column; never beyond the border."""
    inside = (column >= 0) & (column < side)
    return inside & ((words >> jnp.clip(column, 0, 31).astype(jnp.uint32)) & 1 == 1)


def _goes_on(
    local: LocalWindow, cells: jax.Array, place: tuple[jax.Array, ...], spent: jax.Array
) -> jax.Array:
    """Return True where a path that has cost `spent` goes on from a place.

    The place is conflicts, leg, row, column and agent (int32 [K] each) in `cells`.
    """
    *level, row, column, agent = place
    side = local.side
    inside = jnp.clip(row, 0, side - 1)
    if local.costs is None:
        return _is_in(cells[*level, inside, agent], column, side) & (row == inside)
    across = jnp.clip(column, 0, side - 1)
    is_inside = (row == inside) & (column == across)
    return is_inside & (cells[*level, inside, across, agent] == spent)


def _has_served(
    local: LocalWindow, served: jax.Array, place: tuple[jax.Array, ...], spent: jax.Array
) -> jax.Array:
    """Return True where a path that has cost `spent` is in service.

    The place is conflicts, leg, timesteps served and agent (int32 [K] each) in `served`.
    """
    *level, elapsed, agent = place
    if local.costs is None:
        return (served[*level, agent] >> elapsed.astype(jnp.uint32)) & 1 == 1
    return served[*level, elapsed, agent] == spent


def _go_back(
    local: LocalWindow, paths: _Paths, step: tuple[jax.Array, ...]
) -> tuple[_Paths, jax.Array]:
    """Go from where the paths are at t + 1 to where they were at t; returns also the former.

    `step` is what the search found for the step: its reservations (uint32 [5, E, K]), the cells
    that paths go on from at t, and what is served at t and at t + 1 (`ReachableSet`, or
    `LeastCosts`).
    """
    state, spent = paths
    reserved, expandable, served, served_after = step
    agent, side, cap = jnp.arange(state.leg.shape[0]), local.side, expandable.shape[0] - 1
    place = jnp.stack([state.row, state.column])
    service_time = local.service_time[0]
    # Leg 1 began where the service at the current goal ended.
    on_first_goal = _is_in(local.goal[0, state.row, agent], state.column, side)
    first = jnp.zeros_like(state.leg)
    finished = _has_served(
        local, served_after, (state.conflicts, first, service_time, agent), spent
    )
    entered = (state.elapsed < 0) & (state.leg == 1) & on_first_goal & finished
    leg = jnp.where(entered, 0, state.leg)
    served_here = jnp.where(entered, service_time, state.elapsed)
    fewer = jnp.maximum(state.conflicts - 1, 0)
    # Served for one timestep less.
    elapsed = jnp.maximum(served_here - 1, 0)
    spent_if_stayed = spent - local.staying_cost(leg, elapsed, agent)
    conflict = rules.service_conflict(
        state.conflicts,
        _is_in(reserved[0, state.row, agent], state.column, side),
        _has_served(local, served, (fewer, leg, elapsed, agent), spent_if_stayed),
    )
    stayed = PathState(leg, state.conflicts - conflict, state.row, state.column, served_here - 1)
    # Drove: the first neighbour, in order of preference, from which this cell was reached.
    flipped = (local.tie_break >> rules.CODE_BITS) & 1
    conflicts, row, column = state.conflicts, state.row, state.column
    best_rank, spent_if_driven = jnp.full_like(leg, NUM_MOVES), spent
    for move, words in enumerate(conflicting_cells(reserved[:, state.row, agent])):
        i, j = rules.cell_before(state.row, state.column, move)
        # Less than nothing where the move is not allowed: no path has cost that.
        before = spent - local.moving_cost(move, i, j, agent)
        from_same, from_less = (
            _goes_on(local, expandable, (count, leg, i, j, agent), before)
            for count in (state.conflicts, fewer)
        )
        from_less = from_less & (state.conflicts > 0)
        conflicting = _is_in(words, state.column, side)
        possible = rules.is_predecessor(from_same, from_less, conflicting, state.conflicts == cap)
        rank = rules.move_at(move, flipped)  # its own inverse
        better = possible & (rank < best_rank)
        best_rank = jnp.where(better, rank, best_rank)
        conflicts = jnp.where(better, state.conflicts - (conflicting & from_less), conflicts)
        row, column = jnp.where(better, i, row), jnp.where(better, j, column)
        spent_if_driven = jnp.where(better, before, spent_if_driven)
    drove = PathState(leg, conflicts, row, column, jnp.full_like(leg, -1))
    earlier = (jnp.where(served_here > 0, a, b) for a, b in zip(stayed, drove, strict=True))
    spent = jnp.where(served_here > 0, spent_if_stayed, spent_if_driven)
    return (PathState(*earlier), spent), place


def find_paths(local: LocalWindow, levels: int) -> tuple[jax.Array, jax.Array]:
    """Find the best path of every agent in `local`, counting conflicts in `levels` levels.

    Returns rows and columns relative to the start, int32 [2, window + 1, K], and the cost int32 [K]
    of conflicts, of the way left after the window and, where moves have costs, of the moves
    (`INFEASIBLE` where nothing can be reached).
    """
    agent, leg = jnp.arange(local.penalty.shape[0]), jnp.arange(2)[:, None]
    # Is either goal reserved, at each timestep?
    at_goal = (
        local.reserved[:, 0][:, local.goal_row, agent] & local.goal[leg, local.goal_row, agent]
    )
    disturbed = jnp.where(at_goal != 0, jnp.uint32(ALL), jnp.uint32(0))

    sets: tuple[Any, ...] = _start, _advance, _expandable
    numbers: tuple[Any, ...] = _start_costs, _advance_costs, lambda _, least: least.cells
    start, advance, going_on = sets if local.costs is None else numbers

    def step(reached: Any, inputs: tuple[jax.Array, jax.Array]) -> tuple[Any, Any]:
        return advance(local, reached, *inputs), (going_on(local, reached), reached.served)

    begin, inputs = start(local, levels), (local.reserved, disturbed)
    reached, (cells, served) = jax.lax.scan(step, begin, inputs)
    last_cells, last_served = going_on(local, reached), reached.served
    cost, code = _cheapest_end(local, last_cells, last_served)
    served_after = jnp.concatenate([served[1:], last_served[None]])
    end = rules.unpack_end(code, levels, local.side)
    serving = end.elapsed >= 0
    end = end._replace(
        row=jnp.where(serving, local.goal_row[end.leg, agent], end.row),
        column=jnp.where(serving, local.goal_column[end.leg, agent], end.column),
    )
    spent = jnp.zeros_like(code)
    if local.costs is not None:
        driven = last_cells[end.conflicts, end.leg, end.row, end.column, agent]
        stayed = last_served[end.conflicts, end.leg, jnp.maximum(end.elapsed, 0), agent]
        spent = jnp.where(serving, stayed, driven)
    history = local.reserved, cells, served, served_after
    (first, _), path = jax.lax.scan(partial(_go_back, local), (end, spent), history, reverse=True)
    path = jnp.concatenate([jnp.stack([first.row, first.column])[None], path])
    return path.swapaxes(0, 1) - local.side // 2, cost
