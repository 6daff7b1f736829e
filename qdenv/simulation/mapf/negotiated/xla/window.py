"""What agents see: the squares around them, cut out of the maps and of all reservations."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdenv.grid import NUM_MOVES, WAIT
from qdenv.simulation.mapf.negotiated import rules
from qdenv.simulation.mapf.negotiated.settings import MAX_SERVICE
from qdenv.simulation.mapf.planner import AgentState, World

STRIDE = 11  # columns between the starts of neighbouring words of the reservations
ALL = 0xFFFFFFFF  # the mask that holds
FAR = 1 << 28  # cost where no path leads; above all costs in a window


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
    # int32 [5, E, E, K], the cost of each move from each cell in sight, `FAR` where it is not
    # allowed; None where every move costs a timestep
    costs: jax.Array | None
    leg: jax.Array  # int32 [K], on which they set out

    @property
    def side(self) -> int:
        """Rows and columns in sight (E)."""
        return self.traversable.shape[0]

    def staying_cost(self, leg: jax.Array, elapsed: jax.Array, agent: jax.Array) -> jax.Array:
        """Price a timestep at a goal after `elapsed`: service, then waiting."""
        if self.costs is None:
            return jnp.zeros_like(elapsed)
        waiting = self.costs[WAIT, self.goal_row[leg, agent], self.goal_column[leg, agent], agent]
        service, _ = rules.units(1)
        return jnp.where(elapsed < self.service_time[leg, agent], service, waiting)

    def moving_cost(
        self, move: int, row: jax.Array, column: jax.Array, agent: jax.Array
    ) -> jax.Array:
        """Price a move from a cell; `FAR` where it is not allowed."""
        if self.costs is None:
            return jnp.zeros_like(row)
        row, column = jnp.clip(row, 0, self.side - 1), jnp.clip(column, 0, self.side - 1)
        return self.costs[move, row, column, agent]


def around(packed: jax.Array, position: jax.Array, width: int, reach: int) -> jax.Array:
    """Cut the square of ``2 * reach + 1`` cells around every agent (uint32 [..., side, K]).

    Bit j of row i is the cell ``(i - reach, j - reach)`` away from `position` (int32 [K]) in the
    words of a grid of `width` columns (uint32 [..., H', words]). A word holds a reach of 10.
    """
    words = packed.shape[-1]
    row, column = position // width, position % width - reach
    rows = row[None, :] - reach + jnp.arange(2 * reach + 1)[:, None]
    word, bit = column // STRIDE, (column % STRIDE).astype(jnp.uint32)
    seen = packed.reshape(*packed.shape[:-2], -1)[..., rows * words + word[None, :]]
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
    side, costs = 2 * window + 1, world.costs
    unit, per_step = rules.units(int(costs is not None))
    position, rows = state.position[agent], state.row[:, agent]
    # Whatever is longer does not end within a window, however long it is.
    service_time = jnp.minimum(state.service_time[:, agent], MAX_SERVICE)
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
    after = per_step * onwards + unit * service_time[1]
    # Steps from every cell in sight to both goals.
    step = jnp.arange(-window, window + 1)
    cell = jnp.clip(position + (step[:, None] * width + step)[:, :, None], 0, size - 1)
    distance = state.distance.reshape(-1)[rows[:, None, None] * size + cell].astype(jnp.int32)
    shortest = per_step * distance[0, window, window] + unit * service_time[0] + after
    # On the first leg the whole second one is still to come, whichever cell the window ends on.
    after_leg = jnp.stack([after, jnp.zeros_like(after)])
    fixed = unit * service_time + after_leg - shortest
    return LocalWindow(
        reserved=around(table.reshape(-1, NUM_MOVES, *walls.shape), position, width, window),
        traversable=around(walls, position, width, window),
        goal=goal.astype(jnp.uint32),
        goal_row=row,
        goal_column=column,
        cost_to_go=per_step * distance + fixed[:, None, None],
        cost_after_goal=after,
        shortest=shortest,
        service_time=service_time,
        remaining_service=jnp.minimum(state.remaining_service[agent], service_time[0]),
        penalty=penalty,
        tie_break=tie_break,
        costs=None if costs is None else jnp.where(costs > 0, costs, FAR)[:, cell],
        leg=jnp.broadcast_to(state.leg, state.position.shape)[agent],
    )


def conflicting_cells(reserved: jax.Array) -> tuple[jax.Array, ...]:
    """Find the cells where arriving by each move conflicts, from the planes of a step [5, ...].

    Wherever another agent arrives, and against the move by which it left a cell: that is a swap.
    """
    cell, right, left, down, up = reserved
    return cell, cell | left, cell | right, cell | up, cell | down
