"""The agents of one run: where they start, how they drive and serve, what their planner sees."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdenv.simulate.mapf import chance, tasks
from qdenv.simulate.mapf.distances import Fields, measure_fields, no_fields, rows_of
from qdenv.simulate.mapf.planner import AgentState, World, pad, unpad_grid


class Fleet(NamedTuple):
    """The agents between two windows."""

    position: jax.Array  # int32 [A]
    kind: jax.Array  # int32 [A], the current goal's place in the cycle
    goal: jax.Array  # int32 [2, A], slots of the current and the next goal
    remaining_service: jax.Array  # int32 [A], timesteps still to serve
    age: jax.Array  # int32 [A], timesteps since the last finished task
    legs: jax.Array  # int32 [A], tasks finished since all were planned
    previous: jax.Array  # int32 [window + 1, A], the plan from here on
    fields: Fields | None  # distances measured on demand; None where the world has a table of all


def _draw_starts(world: World, active: jax.Array, seed: jax.Array) -> jax.Array:
    """Draw distinct free cells for all agents in `active` (bool [A] -> int32 [A]).

    Padding agents stand on cell 0, a wall.
    """
    # Drawn on the layout without margin: a seed gives the same starts whichever planner drives.
    free = unpad_grid(world.traversable, world.margin)
    cols = free.shape[1]
    bits = chance.draw_many(seed, free.size)
    rank = jnp.where(free.reshape(-1), (bits >> 1).astype(jnp.int32), -1)
    rank, cells = jax.lax.top_k(rank, active.shape[0])
    cells = pad(cells, cols, world.margin)
    # Where the free cells do not suffice walls are drawn, too, and the run is not valid.
    return jnp.where(active & (rank >= 0), cells, 0).astype(jnp.int32)


def place(world: World, window: int, active: jax.Array, seed: jax.Array) -> Fleet:
    """Put the agents on distinct random cells and draw their first goals.

    Args:
        world: where.
        window: timesteps that are planned ahead.
        active: bool [A], False for padding.
        seed: of the run.
    """
    position = _draw_starts(world, active, chance.draw(seed, chance.STARTS))
    zero = jnp.zeros(active.shape, jnp.int32)
    cycle = world.service_time.shape[0]
    goal = [
        tasks.draw_goals(world.goals, (zero + ahead) % cycle, chance.draw(seed, purpose))
        for ahead, purpose in enumerate((chance.FIRST_GOAL, chance.SECOND_GOAL))
    ]
    still = jnp.broadcast_to(position, (window + 1, *active.shape))
    fields = no_fields(world, active.shape[0]) if world.distance is None else None
    return Fleet(position, zero, jnp.stack(goal), zero, zero, zero, still, fields)


def drive(
    world: World, fleet: Fleet, cell: jax.Array, active: jax.Array, seed: jax.Array
) -> tuple[Fleet, jax.Array]:
    """Move every agent to `cell` (int32 [A]) and serve goals; returns who finished (bool [A])."""
    cycle = world.service_time.shape[0]
    service_time = world.service_time[fleet.kind]
    # Where a goal was not known when all were planned, nobody was told to stay.
    known = (fleet.legs < tasks.KNOWN) | (service_time == 0)
    on_goal = (cell == world.goals.cells[fleet.goal[0]]) & active & known
    remaining, finished = tasks.serve(fleet.remaining_service, on_goal, service_time)
    kind = jnp.where(finished, (fleet.kind + 1) % cycle, fleet.kind)
    drawn = tasks.draw_goals(world.goals, (kind + 1) % cycle, seed)
    return fleet._replace(
        position=cell,
        kind=kind,
        goal=jnp.where(finished, jnp.stack([fleet.goal[1], drawn]), fleet.goal),
        remaining_service=remaining,
        age=jnp.where(finished, 0, fleet.age + 1),
        legs=fleet.legs + finished,
    ), finished


def look_ahead(world: World, fleet: Fleet) -> Fleet:
    """Measure the distances to goals that are new, where the world has no table of them."""
    if fleet.fields is None:
        return fleet
    return fleet._replace(fields=measure_fields(world, fleet.fields, fleet.goal))


def agent_state(world: World, fleet: Fleet, active: jax.Array) -> AgentState:
    """Tell the planner what it needs to know, after `look_ahead`.

    Raises:
        ValueError: the world has neither a table of distances nor were any measured.
    """
    cycle = world.service_time.shape[0]
    service_time = world.service_time[jnp.stack([fleet.kind, (fleet.kind + 1) % cycle])]
    distance, row = world.distance, fleet.goal
    if fleet.fields is not None:
        distance, row = fleet.fields.distance, rows_of(fleet.fields)
    if distance is None:
        raise ValueError("there are no distances: prepare the world for this planner")
    return AgentState(
        position=fleet.position,
        active=active,
        goal=fleet.goal,
        service_time=service_time,
        remaining_service=fleet.remaining_service,
        age=fleet.age,
        previous=fleet.previous,
        distance=distance,
        row=row,
    )
