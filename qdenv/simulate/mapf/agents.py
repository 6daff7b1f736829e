"""The agents of one run: where they start, how they drive and serve, what their planner is told."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdenv.simulate.mapf import tasks
from qdenv.simulate.mapf.padding import pad, unpad, unpad_grid
from qdenv.simulate.mapf.planner import AgentState, World

START_MARGIN = 10  # walls around the grid on which starts are drawn, whatever the planner wants


class Fleet(NamedTuple):
    """The agents between two windows.

    Attributes:
        position: int32 [A].
        kind: int32 [A], the current goal's place in the cycle.
        goal: int32 [2, A], slots of the current and the next goal.
        remaining_service: int32 [A], timesteps still to serve.
        age: int32 [A], timesteps since the last finished task.
        previous: int32 [window + 1, A], the plan from here on.
    """

    position: jax.Array
    kind: jax.Array
    goal: jax.Array
    remaining_service: jax.Array
    age: jax.Array
    previous: jax.Array


def draw_starts(world: World, active: jax.Array, key: jax.Array) -> jax.Array:
    """Draw distinct free cells for all agents in `active` (bool [A] -> int32 [A]).

    Padding agents stand on cell 0, a wall. Consumes the key.
    """
    # One margin for all planners: a key gives the same starts whichever of them drives.
    free = jnp.pad(unpad_grid(world.traversable, world.margin), START_MARGIN)
    cols = free.shape[1] - 2 * START_MARGIN
    luck = jnp.where(free.reshape(-1), jax.random.uniform(key, (free.size,)), -1.0)
    luck, cells = jax.lax.top_k(luck, active.shape[0])
    cells = pad(unpad(cells, cols, START_MARGIN), cols, world.margin)
    # Where the free cells do not suffice walls are drawn, too, and the run is not valid.
    return jnp.where(active & (luck >= 0), cells, 0).astype(jnp.int32)


def place(world: World, window: int, active: jax.Array, key: jax.Array) -> Fleet:
    """Put the agents on distinct random cells and draw their first goals; consumes the key.

    Args:
        world: where.
        window: timesteps that are planned ahead.
        active: bool [A], False for padding.
        key: decides cells and goals.
    """
    start_key, *goal_keys = jax.random.split(key, 3)
    position = draw_starts(world, active, start_key)
    zero = jnp.zeros(active.shape, jnp.int32)
    cycle = world.service_time.shape[0]
    goal = [
        tasks.draw_goals(world.goals, (zero + ahead) % cycle, goal_key)
        for ahead, goal_key in enumerate(goal_keys)
    ]
    still = jnp.broadcast_to(position, (window + 1, *active.shape))
    return Fleet(position, zero, jnp.stack(goal), zero, zero, still)


def drive(
    world: World, fleet: Fleet, cell: jax.Array, active: jax.Array, key: jax.Array
) -> tuple[Fleet, jax.Array]:
    """Move every agent to `cell` (int32 [A]) and serve goals; returns who finished (bool [A])."""
    cycle = world.service_time.shape[0]
    on_goal = (cell == world.goals.cells[fleet.goal[0]]) & active
    service_time = world.service_time[fleet.kind]
    remaining, finished = tasks.serve(fleet.remaining_service, on_goal, service_time)
    kind = jnp.where(finished, (fleet.kind + 1) % cycle, fleet.kind)
    drawn = tasks.draw_goals(world.goals, (kind + 1) % cycle, key)
    return fleet._replace(
        position=cell,
        kind=kind,
        goal=jnp.where(finished, jnp.stack([fleet.goal[1], drawn]), fleet.goal),
        remaining_service=remaining,
        age=jnp.where(finished, 0, fleet.age + 1),
    ), finished


def agent_state(world: World, fleet: Fleet, active: jax.Array) -> AgentState:
    """Tell the planner what it needs to know."""
    cycle = world.service_time.shape[0]
    service_time = world.service_time[jnp.stack([fleet.kind, (fleet.kind + 1) % cycle])]
    return AgentState(
        position=fleet.position,
        active=active,
        goal=fleet.goal,
        service_time=service_time,
        remaining_service=fleet.remaining_service,
        age=fleet.age,
        previous=fleet.previous,
    )
