"""The agents of one run: where they start, how they drive and serve goals."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdenv.simulate.mapf import chance, tasks
from qdenv.simulate.mapf.distances import Fields
from qdenv.simulate.mapf.planner import NOBODY, World, pad, steps_type, unpad_grid, unreachable


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


def place(world: World, window: int, active: jax.Array, seed: jax.Array) -> Fleet:
    """Put the agents in `active` (bool [A]) on distinct random cells; draw their first goals.

    The others, padding, stand on cell 0, a wall. `window` timesteps are planned ahead.
    """
    # Drawn on the layout without margin: a seed gives the same starts whichever planner drives.
    free, agents = unpad_grid(world.traversable, world.margin), active.shape[0]
    bits = chance.draw_many(chance.draw(seed, chance.STARTS), free.size)
    rank = jnp.where(free.reshape(-1), (bits >> 1).astype(jnp.int32), -1)
    rank, cells = jax.lax.top_k(rank, agents)
    cells = pad(cells, free.shape[1], world.margin)
    # Where the free cells do not suffice walls are drawn, too, and the run is not valid.
    position = jnp.where(active & (rank >= 0), cells, 0).astype(jnp.int32)
    zero = jnp.zeros(active.shape, jnp.int32)
    cycle = world.service_time.shape[0]
    goal = [
        tasks.draw_goals(world.goals, (zero + ahead) % cycle, chance.draw(seed, purpose))
        for ahead, purpose in enumerate((chance.FIRST_GOAL, chance.SECOND_GOAL))
    ]
    still = jnp.broadcast_to(position, (window + 1, agents))
    fields, size = None, world.traversable.size
    if world.distance is None:
        fields = Fields(
            jnp.full((2 * agents, size), unreachable(size), steps_type(size)),
            jnp.full((2, agents), NOBODY, jnp.int32),
            jnp.zeros((agents,), bool),
        )
    return Fleet(position, zero, jnp.stack(goal), zero, zero, zero, still, fields)


def drive(
    world: World, fleet: Fleet, cell: jax.Array, active: jax.Array, seed: jax.Array
) -> tuple[Fleet, jax.Array]:
    """Move every agent to `cell` (int32 [A]) and serve goals; returns who finished (bool [A])."""
    cycle = world.service_time.shape[0]
    service_time = world.service_time[fleet.kind]
    # An agent does not stay at a goal that its planner did not know.
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
