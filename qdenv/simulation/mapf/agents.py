"""The agents of a run in XLA: placed, driven step by step, given orders."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdenv.grid import inside_frame, pad
from qdenv.simulation.mapf import chance
from qdenv.simulation.mapf.distances import Fields
from qdenv.simulation.mapf.metrics import Orders
from qdenv.simulation.mapf.planner import KNOWN, NEAR, World, draw_goals, serve


class FleetState(NamedTuple):
    """The agents between two windows."""

    position: jax.Array  # int32 [A]
    kind: jax.Array  # int32 [A], the current goal's place in the cycle; its length while idle
    goal: jax.Array  # int32 [2, A], slots of the current and the next goal
    remaining_service: jax.Array  # int32 [A], timesteps still to serve
    age: jax.Array  # int32 [A], timesteps since the last finished task
    legs: jax.Array  # int32 [A], tasks finished since all were planned
    previous: jax.Array  # int32 [window + 1, A], the plan from here on
    fields: Fields | None  # distances measured on demand; None where the world has a table of all
    orders: Orders | None = None  # those that arrived; None where work never runs out


def place(world: World, window: int, active: jax.Array, seed: jax.Array) -> FleetState:
    """Put the agents in `active` (bool [A]) on distinct random cells; draw their first goals.

    The others, padding, stand on cell 0, a wall. `window` timesteps are planned ahead.
    """
    # Drawn on the layout without margin: a seed gives the same starts whichever planner drives.
    free, agents = inside_frame(world.traversable, (world.margin, world.margin)), active.shape[0]
    bits = chance.draw(chance.draw(seed, chance.STARTS), jnp.arange(free.size))
    rank = jnp.where(free.reshape(-1), (bits >> 1).astype(jnp.int32), -1)
    rank, cells = jax.lax.top_k(rank, agents)
    cells = pad(cells, free.shape[1], world.margin)
    # Where the free cells do not suffice walls are drawn, too, and the run is not valid.
    position = jnp.where(active & (rank >= 0), cells, 0).astype(jnp.int32)
    zero = jnp.zeros(active.shape, jnp.int32)
    cycle = world.goals.odds.shape[0]
    goal = [
        draw_goals(world.goals, (zero + ahead) % cycle, chance.draw(seed, purpose))
        for ahead, purpose in enumerate((chance.FIRST_GOAL, chance.SECOND_GOAL))
    ]
    kind, orders = zero, None
    if world.orders is not None:  # all are idle, where they are
        kind, goal = zero + cycle, [_slot_at(world, position)] * 2
        orders = Orders(jnp.int32(0), jnp.int32(0), jnp.float32(0))
    still = jnp.broadcast_to(position, (window + 1, agents))
    fields = Fields.empty(world, agents) if world.distance is None else None
    return FleetState(position, kind, jnp.stack(goal), zero, zero, zero, still, fields, orders)


def drive(
    world: World, fleet: FleetState, cell: jax.Array, active: jax.Array, seed: jax.Array
) -> tuple[FleetState, jax.Array]:
    """Move every agent to `cell` (int32 [A]) and serve goals; returns who finished (bool [A]).

    Where tasks arrive at a rate, who has finished an order begins the next that waits, or is idle.
    """
    cycle = world.goals.odds.shape[0]
    service_time = world.goals.service_time[fleet.kind, fleet.goal[0]]
    # An agent does not stay at a goal that its planner did not know.
    known = (fleet.legs < KNOWN) | (service_time == 0)
    on_goal = (cell == world.goals.cells[fleet.goal[0]]) & active & known & (fleet.kind < cycle)
    remaining, finished = serve(fleet.remaining_service, on_goal, service_time)
    kind = jnp.where(finished, (fleet.kind + 1) % cycle, fleet.kind)
    drawn = draw_goals(world.goals, (kind + 1) % cycle, seed)
    goal = jnp.where(finished, jnp.stack([fleet.goal[1], drawn]), fleet.goal)
    orders = fleet.orders
    if orders is not None:
        free = finished & (kind == 0)
        idle = free & (jnp.cumsum(free) > orders.waiting)
        orders = _begin_orders(orders, free & ~idle)
        kind, goal = jnp.where(idle, cycle, kind), jnp.where(idle, goal[0], goal)
    return fleet._replace(
        position=cell,
        kind=kind,
        goal=goal,
        remaining_service=remaining,
        # An idle agent gives way to all others.
        age=jnp.where(finished | (kind == cycle), 0, fleet.age + 1),
        legs=fleet.legs + finished,
        orders=orders,
    ), finished


def _slot_at(world: World, cell: jax.Array) -> jax.Array:
    """Find the slots of goal cells (int32 [A])."""
    slots, size = jnp.arange(world.goals.cells.size, dtype=jnp.int32), world.traversable.size
    cells = jnp.where(world.goals.used, world.goals.cells, size)
    return jnp.zeros((size,), jnp.int32).at[cells].set(slots, mode="drop")[cell]


def _begin_orders(orders: Orders, who: jax.Array) -> Orders:
    """Give an order that waits to each agent in `who` (bool [A])."""
    count = who.sum(dtype=jnp.int32)
    return orders._replace(waiting=orders.waiting - count, begun=orders.begun + count)


def hand_out(
    world: World, fleet: FleetState, active: jax.Array, seed: jax.Array, time: jax.Array
) -> FleetState:
    """Give the orders that wait to idle agents by lot, with new goals.

    Those left without one wait where they are, once near their place, which two may share.
    """
    cycle, orders = world.goals.odds.shape[0], fleet.orders
    if orders is None:
        return fleet
    idle, count = active & (fleet.kind == cycle), active.shape[0]
    bits = chance.draw(chance.draw(chance.draw(seed, chance.ORDERS), time), jnp.arange(count))
    lot = jnp.argsort(jnp.where(idle, (bits >> 1).astype(jnp.int32), jnp.int32(2**31 - 1)))
    begins = idle.at[lot].set(idle[lot] & (jnp.arange(count) < orders.waiting))
    kind = jnp.where(begins, 0, fleet.kind)
    goal = [
        draw_goals(world.goals, (kind + ahead) % cycle, chance.draw(chance.draw(seed, one), time))
        for ahead, one in enumerate((chance.FIRST_GOAL, chance.SECOND_GOAL))
    ]
    width, place = world.traversable.shape[1], world.goals.cells[fleet.goal[0]]
    there, here = jnp.divmod(place, width), jnp.divmod(fleet.position, width)
    near = abs(there[0] - here[0]) + abs(there[1] - here[1]) <= NEAR
    waits = jnp.where(idle & near, _slot_at(world, fleet.position), fleet.goal)
    return fleet._replace(
        kind=kind,
        goal=jnp.where(begins, jnp.stack(goal), waits),
        orders=_begin_orders(orders, begins),
    )
