"""The best path of one agent through a window, given what the others have reserved.

Every set of cells is a square of bits around the agent, one word per row. Which cells can be
reached at time t + 1 follows from those at time t by shifting words. The sets are separate by
leg and by the number of conflicts (`rules`); a *mask* is a word that is all ones or empty.

Only the end of a path has a cost: the steps still to go from there, plus a penalty per conflict.
The path itself is read off backwards: which neighbour was expandable one step before?

While an agent serves at a goal it is in no set; bit e of `served` says that a path exists by which
it has been serving for e timesteps.
"""

from functools import partial
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp

from qdenv.grid import NUM_MOVES
from qdenv.simulate.mapf.negotiated import rules
from qdenv.simulate.mapf.negotiated.rules import COST_UNIT, PathState
from qdenv.simulate.mapf.planner import AgentState, World

STRIDE = 11  # columns between the starts of neighbouring words of the reservations
_ALL = 0xFFFFFFFF  # the mask that holds

PathStates: TypeAlias = PathState[jax.Array]  # of K paths


class LocalWindow(NamedTuple):
    """What K agents see around them: squares of side E = 2 * window + 1, at most 21."""

    reserved: jax.Array  # uint32 [window, 5, E, K], reserved cells and moves (`xla.rounds`)
    traversable: jax.Array  # uint32 [E, K], cells without walls
    goal: jax.Array  # uint32 [2, E, K], the current and the next goal, where they end a leg
    goal_row: jax.Array  # int32 [2, K], their rows in sight (0 where out of sight)
    goal_column: jax.Array  # int32 [2, K], their columns
    # int32 [2, E, E, K], cost of what is left from each cell on, per leg, less `shortest`
    cost_to_go: jax.Array
    cost_after_goal: jax.Array  # int32 [K], cost of what is left once the current goal is done
    # int32 [K], cost of the shortest way through both goals; costs to go are counted from it, for
    # the keys of ends have no room for that of a long way
    shortest: jax.Array
    service_time: jax.Array  # int32 [2, K], timesteps to serve at each goal
    # int32 [K], timesteps still to serve where the agent is; 0 while driving
    remaining_service: jax.Array
    penalty: jax.Array  # int32 [K], cost of a conflict
    tie_break: jax.Array  # int32 [K], random bits that settle ties

    @property
    def side(self) -> int:
        """Rows and columns in sight (E)."""
        return self.traversable.shape[0]


class ReachableSet(NamedTuple):
    """What can be reached at one timestep; the axes are conflicts (L levels), leg, row, agent.

    The order matters for speed: whole levels and rows move as blocks, agents lie side by side.
    """

    cells: jax.Array  # uint32 [L, 2, E, K], reached by driving, goals included
    served: jax.Array  # uint32 [L, 2, K], bit e: serving for e timesteps
    # uint32 [L, 2, 1, K], mask: on leg 1, service at the current goal just ended
    just_served: jax.Array


def around(packed: jax.Array, position: jax.Array, width: int, reach: int) -> jax.Array:
    """Cut the square of ``2 * reach + 1`` cells around every agent (uint32 [..., side, K]).

    Bit j of row i is the cell ``(i - reach, j - reach)`` away from `position` (int32 [K]) in the
    words of a grid of `width` columns (uint32 [..., H', words]). A word holds a reach of 10.
    """
    words = packed.shape[-1]
    row, column = position // width, position % width - reach
    rows = row[None, :] - reach + jnp.arange(2 * reach + 1)[:, None]
    word, bit = column // STRIDE, (column % STRIDE).astype(jnp.uint32)
    flat = packed.reshape(*packed.shape[:-2], -1)
    seen = flat[..., rows * words + word[None, :]]
    return (seen >> bit) & jnp.uint32((1 << (2 * reach + 1)) - 1)


def gather(
    world: World,
    state: AgentState,
    table: jax.Array,
    walls: jax.Array,
    agent: jax.Array,
    penalty: jax.Array,
    tie_break: jax.Array,
) -> LocalWindow:
    """Cut out what K agents see; the length of the previous paths of all is the window.

    `table` (uint32, flat) are the packed reservations, `walls` (uint32 [H', words]) the packed
    traversable cells; `agent`, `penalty` and `tie_break` are int32 [K].
    """
    width, size = world.traversable.shape[1], world.traversable.size
    window = state.previous.shape[0] - 1
    side = 2 * window + 1
    position, rows = state.position[agent], state.row[:, agent]
    service_time = state.service_time[:, agent]
    goals = world.goals.cells[state.goal[:, agent]]
    row, column = rules.find_in_window(goals, position, width, window)
    ends = jnp.stack([rules.ends_leg(leg, service_time[leg]) for leg in range(2)])
    seen = ends & (row >= 0) & (row < side) & (column >= 0) & (column < side)
    # A goal out of sight keeps place (0, 0) and an empty set: no branch, and nothing ever arrives.
    row, column = jnp.where(seen, row, 0), jnp.where(seen, column, 0)
    bit = jnp.where(seen, jnp.uint32(1) << column.astype(jnp.uint32), 0)
    goal = jnp.where(jnp.arange(side)[:, None] == row[:, None], bit[:, None], 0)
    # Once the current goal is done, the way to the next one and the service there are left.
    onwards = state.distance[rows[1], goals[0]].astype(jnp.int32)
    after = COST_UNIT * (onwards + service_time[1])
    # Steps from every cell in sight to both goals.
    step = jnp.arange(-window, window + 1)
    cell = jnp.clip(position + (step[:, None] * width + step)[:, :, None], 0, size - 1)
    distance = state.distance.reshape(-1)[rows[:, None, None] * size + cell].astype(jnp.int32)
    shortest = COST_UNIT * (distance[0, window, window] + service_time[0]) + after
    # On the first leg the whole second one is still to come, whichever cell the window ends on.
    after_leg = jnp.stack([after, jnp.zeros_like(after)])
    fixed = COST_UNIT * service_time + after_leg - shortest
    planes = table.reshape(-1, NUM_MOVES, *walls.shape)
    return LocalWindow(
        reserved=around(planes, position, width, window),
        traversable=around(walls, position, width, window),
        goal=goal.astype(jnp.uint32),
        goal_row=row,
        goal_column=column,
        cost_to_go=COST_UNIT * distance + fixed[:, None, None],
        cost_after_goal=after,
        shortest=shortest,
        service_time=service_time,
        remaining_service=state.remaining_service[agent],
        penalty=penalty,
        tie_break=tie_break,
    )


def _expandable(local: LocalWindow, reached: ReachableSet) -> jax.Array:
    """List the cells that paths go on from (uint32 [L, 2, E, K]).

    A goal is left only after service, on the next leg.
    """
    return (reached.cells & ~local.goal) | (reached.just_served & local.goal[:1])


def _conflicting_cells(reserved: jax.Array) -> tuple[jax.Array, ...]:
    """Find the cells where arriving by each move conflicts, from the planes of a step [5, ...].

    Wherever another agent arrives, and against the move by which it left a cell: that is a swap.
    """
    cell, right, left, down, up = reserved
    return cell, cell | left, cell | right, cell | up, cell | down


def _by_conflicts(clean: jax.Array, conflicting: jax.Array) -> jax.Array:
    """Give each conflict level (axis 0) its set after a step with a further conflict or without.

    Paths with one conflict more come from the level below; the last level keeps its own.
    """
    levels = clean.shape[0]
    cap = (jnp.arange(levels) == levels - 1).reshape(-1, *[1] * (clean.ndim - 1))
    below = jnp.concatenate([jnp.zeros_like(conflicting[:1]), conflicting[:-1]])
    return clean | below | jnp.where(cap, conflicting, 0)


def _start(local: LocalWindow, levels: int) -> ReachableSet:
    """Set what is reached before the first step: the middle, or the service under way."""
    agents, side = local.penalty.shape[0], local.side
    middle, driving = side // 2, local.remaining_service == 0
    here = jnp.where(driving, jnp.uint32(1 << middle), 0)
    elapsed = (local.service_time[0] - local.remaining_service).astype(jnp.uint32)
    cells = jnp.zeros((levels, 2, side, agents), jnp.uint32).at[0, 0, middle].set(here)
    served = jnp.zeros((levels, 2, agents), jnp.uint32)
    served = served.at[0, 0].set(jnp.where(driving, 0, jnp.uint32(1) << elapsed))
    # Standing on the goal is not arriving: the path leaves it like any other cell.
    on_goal = driving & ((local.goal[0, middle] >> middle) & 1 == 1)
    just_served = jnp.zeros((levels, 2, 1, agents), jnp.uint32)
    just_served = just_served.at[0, 0, 0].set(jnp.where(on_goal, jnp.uint32(_ALL), 0))
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
    for arriving, taken in zip(moved, _conflicting_cells(reserved), strict=True):
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


def _cheapest_end(
    local: LocalWindow, cells: jax.Array, served: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Choose where to be after the window (cost and code, both int32 [K]).

    `cells` (uint32 [L, 2, E, K]) are expandable at the end, `served` is uint32 [L, 2, K] then.
    """
    levels, side = cells.shape[0], local.side
    row, column = jnp.arange(side)[:, None, None], jnp.arange(side)[:, None]
    elapsed = jnp.arange(rules.SERVED_BITS)[:, None]
    tie = local.tie_break & rules.CODES
    best = jnp.full(tie.shape, rules.INFEASIBLE, jnp.int32)

    def cheapest(
        best: jax.Array, is_here: jax.Array, cost: jax.Array, code: jax.Array
    ) -> jax.Array:
        # Cost and code in one number: the smallest is the best end, ties fall by chance.
        key = (cost << rules.CODE_BITS) | (code ^ tie)
        key = jnp.where(is_here, key, rules.INFEASIBLE)
        return jnp.minimum(best, key.min(tuple(range(key.ndim - 1))))

    for leg in range(2):
        after = (1 - leg) * local.cost_after_goal - local.shortest
        left = jnp.maximum(local.service_time[leg] - elapsed, 0)
        service_cost = COST_UNIT * left + after
        for conflicts in range(levels):
            price = conflicts * local.penalty
            is_here = (cells[conflicts, leg][:, None] >> column.astype(jnp.uint32)) & 1 == 1
            code = rules.driving_end(leg, conflicts, levels, row, column, side)
            best = cheapest(best, is_here, local.cost_to_go[leg] + price, code)
            is_here = (served[conflicts, leg] >> elapsed.astype(jnp.uint32)) & 1 == 1
            code = rules.serving_end(leg, conflicts, levels, elapsed, side)
            best = cheapest(best, is_here, service_cost + price, code)
    found = best < rules.INFEASIBLE
    code = jnp.where(found, (best ^ tie) & rules.CODES, 0)
    cost = (best >> rules.CODE_BITS) + local.shortest
    return jnp.where(found, cost, rules.INFEASIBLE), code


def _is_in(words: jax.Array, column: jax.Array, side: int) -> jax.Array:
    """Return True where a word (uint32 [K]) has the bit of its column; never beyond the border."""
    inside = (column >= 0) & (column < side)
    return inside & ((words >> jnp.clip(column, 0, 31).astype(jnp.uint32)) & 1 == 1)


def _go_back(
    local: LocalWindow, state: PathStates, step: tuple[jax.Array, ...]
) -> tuple[PathStates, jax.Array]:
    """Go from where the paths are at t + 1 to where they were at t; returns also the former.

    `step` is what the search found for the step: its reservations (uint32 [5, E, K]), the cells
    that paths go on from at t, by conflicts and leg (uint32 [L, 2, E, K]), and the timesteps served
    at t and at t + 1 (uint32 [L, 2, K]).
    """
    reserved, expandable, served, served_after = step
    agent, side, cap = jnp.arange(state.leg.shape[0]), local.side, expandable.shape[0] - 1
    place = jnp.stack([state.row, state.column])
    service_time = local.service_time[0]
    # Leg 1 began where the service at the current goal ended.
    on_first_goal = _is_in(local.goal[0, state.row, agent], state.column, side)
    finished = served_after[state.conflicts, 0, agent] >> service_time.astype(jnp.uint32)
    entered = (state.elapsed < 0) & (state.leg == 1) & on_first_goal & (finished & 1 == 1)
    leg = jnp.where(entered, 0, state.leg)
    served_here = jnp.where(entered, service_time, state.elapsed)
    fewer = jnp.maximum(state.conflicts - 1, 0)
    # Served for one timestep less.
    elapsed = jnp.maximum(served_here - 1, 0).astype(jnp.uint32)
    conflict = rules.service_conflict(
        state.conflicts,
        _is_in(reserved[0, state.row, agent], state.column, side),
        (served[fewer, leg, agent] >> elapsed) & 1 == 1,
    )
    stayed = PathState(leg, state.conflicts - conflict, state.row, state.column, served_here - 1)
    # Drove: the first neighbour, in order of preference, from which this cell was reached.
    flipped = (local.tie_break >> rules.CODE_BITS) & 1
    conflicts, row, column = state.conflicts, state.row, state.column
    best_rank = jnp.full_like(leg, NUM_MOVES)
    for move, words in enumerate(_conflicting_cells(reserved[:, state.row, agent])):
        i, j = rules.cell_before(state.row, state.column, move)
        inside = jnp.clip(i, 0, side - 1)
        same, less = (expandable[count, leg, inside, agent] for count in (state.conflicts, fewer))
        from_same = _is_in(same, j, side) & (i == inside)
        from_less = _is_in(less, j, side) & (i == inside) & (state.conflicts > 0)
        conflicting = _is_in(words, state.column, side)
        possible = rules.is_predecessor(from_same, from_less, conflicting, state.conflicts == cap)
        rank = rules.move_at(move, flipped)  # its own inverse
        better = possible & (rank < best_rank)
        best_rank = jnp.where(better, rank, best_rank)
        conflicts = jnp.where(better, state.conflicts - (conflicting & from_less), conflicts)
        row, column = jnp.where(better, i, row), jnp.where(better, j, column)
    drove = PathState(leg, conflicts, row, column, jnp.full_like(leg, -1))
    before = (jnp.where(served_here > 0, a, b) for a, b in zip(stayed, drove, strict=True))
    return PathState(*before), place


def find_paths(local: LocalWindow, levels: int) -> tuple[jax.Array, jax.Array]:
    """Find the best path of every agent in `local`, counting conflicts in `levels` levels.

    Returns rows and columns relative to the start, int32 [2, window + 1, K], and the cost int32 [K]
    from the end of the window on (`INFEASIBLE` where nothing can be reached).
    """
    agent, leg = jnp.arange(local.penalty.shape[0]), jnp.arange(2)[:, None]
    # Is either goal reserved, at each timestep?
    at_goal = (
        local.reserved[:, 0][:, local.goal_row, agent] & local.goal[leg, local.goal_row, agent]
    )
    disturbed = jnp.where(at_goal != 0, jnp.uint32(_ALL), jnp.uint32(0))

    def forward(
        reached: ReachableSet, inputs: tuple[jax.Array, jax.Array]
    ) -> tuple[ReachableSet, tuple[jax.Array, jax.Array]]:
        return _advance(local, reached, *inputs), (_expandable(local, reached), reached.served)

    begin = _start(local, levels)
    last, (cells, served) = jax.lax.scan(forward, begin, (local.reserved, disturbed))
    cost, code = _cheapest_end(local, _expandable(local, last), last.served)
    served_after = jnp.concatenate([served[1:], last.served[None]])
    end = rules.unpack_end(code, levels, local.side)
    serving = end.elapsed >= 0
    end = end._replace(
        row=jnp.where(serving, local.goal_row[end.leg, agent], end.row),
        column=jnp.where(serving, local.goal_column[end.leg, agent], end.column),
    )

    history = local.reserved, cells, served, served_after
    first, path = jax.lax.scan(partial(_go_back, local), end, history, reverse=True)
    path = jnp.concatenate([jnp.stack([first.row, first.column])[None], path])
    return path.swapaxes(0, 1) - local.side // 2, cost
