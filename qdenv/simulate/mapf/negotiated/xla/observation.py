"""What planning agents see around them, as words of bits."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdenv.grid import NUM_MOVES
from qdenv.simulate.mapf.negotiated import rules
from qdenv.simulate.mapf.negotiated.path_rules import COST_UNIT
from qdenv.simulate.mapf.negotiated.xla.reservations import around
from qdenv.simulate.mapf.planner import AgentState, World


class LocalWindow(NamedTuple):
    """What K agents see around them: squares of side E = 2 * window + 1, at most 21."""

    reserved: jax.Array  # uint32 [window, 5, E, K], reserved cells and moves (`xla.reservations`)
    traversable: jax.Array  # uint32 [E, K], cells without walls
    goal: jax.Array  # uint32 [2, E, K], the current and the next goal, where they end a leg
    goal_row: jax.Array  # int32 [2, K], their rows in sight (0 where out of sight)
    goal_column: jax.Array  # int32 [2, K], likewise
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


def gather(
    world: World,
    state: AgentState,
    table: jax.Array,
    walls: jax.Array,
    agent: jax.Array,
    penalty: jax.Array,
    tie_break: jax.Array,
) -> LocalWindow:
    """Cut out what K agents see.

    Args:
        world: the layout.
        state: all agents; the length of its previous paths is the window.
        table: uint32, flat, the packed reservations (`empty`).
        walls: uint32 [H', words], the packed traversable cells.
        agent: int32 [K].
        penalty: int32 [K], cost of a conflict.
        tie_break: int32 [K], random bits that settle ties.
    """
    width, size = world.traversable.shape[1], world.traversable.size
    window = state.previous.shape[0] - 1
    side = 2 * window + 1
    position, rows = state.position[agent], state.row[:, agent]
    service_time = state.service_time[:, agent]
    goals = world.goals.cells[state.goal[:, agent]]
    row = rules.goal_row(goals, position, width, window)
    column = rules.goal_column(goals, position, width, window)
    ends = jnp.stack([rules.ends_leg(leg, service_time[leg]) for leg in range(2)])
    seen = ends & rules.is_visible(row, column, side)
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
