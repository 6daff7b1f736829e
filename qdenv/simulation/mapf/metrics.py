"""What is counted and recorded while a fleet drives: tasks, cell usage, jams, whole recordings."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdenv.grid import inside_frame, pad
from qdenv.simulation.mapf.planner import NOBODY, World
from qdenv.types import Traffic


class Block(NamedTuple):
    """What happened in the executed steps of one window, each [h, A]."""

    positions: jax.Array  # int32, after the step
    remaining_service: jax.Array  # int32, after the step
    finished: jax.Array  # bool, the step finished a task
    goals: jax.Array  # int32, goal cells before the step; `NOBODY` of an idle agent


class Orders(NamedTuple):
    """Orders that arrive at a rate."""

    waiting: jax.Array  # int32, how many have no agent yet
    begun: jax.Array  # int32, how many have had one
    waited: jax.Array  # float32, timesteps that all of them waited


class Counters(NamedTuple):
    """What was counted so far; T is rounded up to whole windows."""

    time: jax.Array  # int32, timesteps driven
    # int32, timesteps driven when the first congested window ended; 0 for none
    congested_at: jax.Array
    finished: jax.Array  # int32 [T], tasks finished at each timestep
    visits: jax.Array  # int32 [H' * W'], agent-steps spent on each cell of the padded grid
    moves: jax.Array  # int32, agent-steps with a move
    idle: jax.Array  # int32, agent-steps without an order


class Recording(NamedTuple):
    """A whole run, for the audit and for pictures; positions on the layout without margin."""

    positions: jax.Array  # int32 [T + 1, A]; after the end of the run the last position is repeated
    # int32 [T + 1, A], the goal cell each agent is heading for before the step; `NOBODY` where it
    # is idle
    goals: jax.Array
    remaining_service: jax.Array  # int32 [T + 1, A], timesteps it must still remain on its goal
    finished: jax.Array  # bool [T, A], tasks finished by the step
    active: jax.Array  # bool [A]


class Outcome(NamedTuple):
    """What a run leaves behind."""

    counters: Counters  # what was counted
    heading: jax.Array  # int32 [A], the goal cells at the end; `NOBODY` of an idle agent
    start: jax.Array  # int32 [A], the first positions
    block: Block  # every step, each [T, A]; without rows where nothing is recorded
    orders: Orders | None = None  # those that arrived; None where work never runs out


def accumulate(
    counters: Counters,
    position: jax.Array,
    remaining_service: jax.Array,
    block: Block,
    active: jax.Array,
    timesteps: int,
) -> Counters:
    """Count the driven steps of a window, and look for a jam.

    Steps beyond `timesteps` and padding agents do not count. More than half of the agents stuck
    make a jam: on the same cell at all timesteps of the window but the last, never serving or idle.
    `position` and `remaining_service` are those before the window, `active` is bool [A].
    """
    horizon = block.positions.shape[0]
    path = jnp.concatenate([position[None], block.positions])
    remaining = jnp.concatenate([remaining_service[None], block.remaining_service])[:-1]
    idle = block.goals == NOBODY
    stuck = (path[:-1] == path[:1]).all(0) & ~((remaining > 0) | idle).any(0) & active
    # A window that T cuts short is no window of the jam rule.
    whole = counters.time + horizon <= timesteps
    first = whole & (stuck.sum() > active.sum() // 2) & (counters.congested_at == 0)
    counts = (counters.time + jnp.arange(horizon) < timesteps)[:, None] & active[None, :]
    finished = (block.finished & counts).sum(1, dtype=jnp.int32)
    time = jnp.minimum(counters.time + horizon, timesteps)
    return Counters(
        time=time,
        congested_at=jnp.where(first, time, counters.congested_at),
        finished=jax.lax.dynamic_update_slice(counters.finished, finished, (counters.time,)),
        visits=counters.visits.at[block.positions].add(counts.astype(jnp.int32)),
        moves=counters.moves + ((block.positions != path[:-1]) & counts).sum(dtype=jnp.int32),
        idle=counters.idle + (idle & counts).sum(dtype=jnp.int32),
    )


def summarise(world: World, outcome: Outcome, active: jax.Array, timesteps: int) -> Traffic:
    """Turn the counts into the record that other stages read."""
    counters, orders = outcome.counters, outcome.orders
    finished = counters.finished[:timesteps]
    visits = inside_frame(
        counters.visits.reshape(world.traversable.shape), (world.margin, world.margin)
    )
    steps = jnp.maximum(counters.time * active.sum(), 1).astype(jnp.float32)
    total = finished.sum()
    return Traffic(
        throughput=total / jnp.float32(timesteps),
        congested=(counters.congested_at > 0) | ~world.valid,
        end_timestep=counters.time,
        finished=finished,
        usage=visits / jnp.maximum(visits.sum(), 1).astype(jnp.float32),
        waiting=1.0 - counters.moves / steps,
        path_length=counters.moves / jnp.maximum(total, 1).astype(jnp.float32),
        congested_at=counters.congested_at,
        idle=None if orders is None else counters.idle / steps,
        order_wait=None if orders is None else orders.waited / jnp.maximum(orders.begun, 1),
    )


def recording_of(outcome: Outcome, active: jax.Array, world: World, timesteps: int) -> Recording:
    """Cut a recorded run to T steps and translate its positions; nothing moves after the end.

    An agent that takes no part (`active`, bool [A]) is nowhere, all zeros.
    """
    counters, heading, start, block, _ = outcome
    cols = world.traversable.shape[1]
    row = jnp.minimum(jnp.arange(timesteps), jnp.maximum(counters.time - 1, 0))
    driven = (jnp.arange(timesteps) < counters.time)[:, None]
    # The last block may reach beyond T: then it knows the goals at T, else the fleet does.
    total = block.goals.shape[0]
    known = jnp.where(counters.time == timesteps, total, counters.time)
    time = jnp.arange(timesteps + 1)
    goals = block.goals[jnp.minimum(time, total - 1)]
    goals = jnp.where((time < known)[:, None], goals, heading[None])
    goals = jnp.where(goals == NOBODY, NOBODY, pad(goals, cols, -world.margin))
    positions = jnp.concatenate([start[None], block.positions[row]])
    remaining = jnp.concatenate([jnp.zeros_like(start)[None], block.remaining_service[row]])
    takes_part = active[None]
    return Recording(
        positions=jnp.where(takes_part, pad(positions, cols, -world.margin), 0),
        goals=jnp.where(takes_part, goals, 0),
        remaining_service=jnp.where(takes_part, remaining, 0),
        finished=block.finished[:timesteps] & driven & takes_part,
        active=active,
    )
