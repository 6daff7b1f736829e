"""What is counted and kept while a fleet drives: tasks, cell usage, jams, whole recordings."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdenv.simulate.mapf.planner import World, unpad, unpad_grid
from qdenv.types import Traffic


class Block(NamedTuple):
    """What happened in the executed steps of one window, each [h, A]."""

    positions: jax.Array  # int32, after the step
    remaining_service: jax.Array  # int32, after the step
    finished: jax.Array  # bool, the step finished a task
    goals: jax.Array  # int32, goal cells before the step


class Metrics(NamedTuple):
    """What was counted so far; T is rounded up to whole windows."""

    time: jax.Array  # int32, timesteps driven
    # int32, timesteps driven when the first congested window ended; 0 for none
    congested_at: jax.Array
    finished: jax.Array  # int32 [T], tasks finished at each timestep
    visits: jax.Array  # int32 [H' * W'], agent-steps spent on each cell of the padded grid
    moves: jax.Array  # int32, agent-steps with a move


class Recording(NamedTuple):
    """A whole run, for the audit and for pictures; positions on the layout without margin."""

    positions: jax.Array  # int32 [T + 1, A]; after the end of the run the last position is repeated
    goals: jax.Array  # int32 [T + 1, A], the goal cell each agent is heading for before the step
    remaining_service: jax.Array  # int32 [T + 1, A], timesteps it must still remain on its goal
    finished: jax.Array  # bool [T, A], tasks finished by the step
    active: jax.Array  # bool [A]


def empty_metrics(world: World, timesteps: int) -> Metrics:
    """Begin to count a run of `timesteps`, a multiple of the replanning period."""
    return Metrics(
        time=jnp.int32(0),
        congested_at=jnp.int32(0),
        finished=jnp.zeros((timesteps,), jnp.int32),
        visits=jnp.zeros((world.traversable.size,), jnp.int32),
        moves=jnp.int32(0),
    )


def is_congested(
    start: jax.Array, remaining_service: jax.Array, block: Block, active: jax.Array
) -> jax.Array:
    """Return whether more than half of the agents are stuck.

    Stuck: the same cell at all timesteps of the window but the last, and never serving.

    Args:
        start: int32 [A], positions before the block.
        remaining_service: int32 [A], before the block.
        block: the driven steps.
        active: bool [A].
    """
    path = jnp.concatenate([start[None], block.positions])[:-1]
    remaining = jnp.concatenate([remaining_service[None], block.remaining_service])[:-1]
    stuck = (path == path[:1]).all(0) & ~(remaining > 0).any(0) & active
    return stuck.sum() > active.sum() // 2


def accumulate(
    metrics: Metrics, start: jax.Array, block: Block, active: jax.Array, timesteps: int
) -> Metrics:
    """Count the driven steps; steps beyond `timesteps` and padding agents do not count.

    Args:
        metrics: counted so far.
        start: int32 [A], positions before the block.
        block: the driven steps.
        active: bool [A].
        timesteps: T of the run.
    """
    horizon = block.positions.shape[0]
    counts = (metrics.time + jnp.arange(horizon) < timesteps)[:, None] & active[None, :]
    before = jnp.concatenate([start[None], block.positions[:-1]])
    finished = (block.finished & counts).sum(1, dtype=jnp.int32)
    return Metrics(
        time=jnp.minimum(metrics.time + horizon, timesteps),
        congested_at=metrics.congested_at,
        finished=jax.lax.dynamic_update_slice(metrics.finished, finished, (metrics.time,)),
        visits=metrics.visits.at[block.positions].add(counts.astype(jnp.int32)),
        moves=metrics.moves + ((block.positions != before) & counts).sum(dtype=jnp.int32),
    )


def summarise(world: World, metrics: Metrics, active: jax.Array, timesteps: int) -> Traffic:
    """Turn the counts into the record that other stages read."""
    finished = metrics.finished[:timesteps]
    visits = unpad_grid(metrics.visits.reshape(world.traversable.shape), world.margin)
    steps = jnp.maximum(metrics.time * active.sum(), 1).astype(jnp.float32)
    total = finished.sum()
    return Traffic(
        throughput=total / jnp.float32(timesteps),
        congested=(metrics.congested_at > 0) | ~world.valid,
        end_timestep=metrics.time,
        finished=finished,
        usage=visits / jnp.maximum(visits.sum(), 1).astype(jnp.float32),
        waiting=1.0 - metrics.moves / steps,
        path_length=metrics.moves / jnp.maximum(total, 1).astype(jnp.float32),
        congested_at=metrics.congested_at,
    )


class TrajectoryBuffer(NamedTuple):
    """All blocks of a run so far, and where the agents began."""

    start: jax.Array  # int32 [A], the first positions
    block: Block  # what happened, each [T, A]; T is rounded up to whole windows

    @classmethod
    def empty(cls, start: jax.Array, timesteps: int) -> "TrajectoryBuffer":
        """Make room for `timesteps` steps of agents that begin at `start` (int32 [A]).

        A buffer for 0 timesteps keeps nothing.
        """
        blank = jnp.zeros((timesteps, start.shape[0]), jnp.int32)
        return cls(start, Block(blank, blank, blank.astype(bool), blank))

    def store(self, block: Block, time: jax.Array) -> "TrajectoryBuffer":
        """Write a block at its time."""
        if self.block.positions.shape[0] == 0:
            return self

        def write(rows: jax.Array, part: jax.Array) -> jax.Array:
            return jax.lax.dynamic_update_slice(rows, part, (time, 0))

        return self._replace(block=jax.tree.map(write, self.block, block))


class Outcome(NamedTuple):
    """What a run leaves behind."""

    metrics: Metrics  # what was counted
    heading: jax.Array  # int32 [A], the goal cells at the end
    buffer: TrajectoryBuffer  # what was recorded; without room where nothing was to be


def recording_of(outcome: Outcome, active: jax.Array, world: World, timesteps: int) -> Recording:
    """Cut the buffer to T steps and translate its positions; nothing moves after the end.

    Args:
        outcome: of the run.
        active: bool [A]; an agent that takes no part is nowhere, all zeros.
        world: where the agents drove.
        timesteps: T of the run.
    """
    metrics, last_goal, buffer = outcome
    cols = world.traversable.shape[1] - 2 * world.margin
    last = jnp.maximum(metrics.time - 1, 0)
    row = jnp.minimum(jnp.arange(timesteps), last)
    driven = (jnp.arange(timesteps) < metrics.time)[:, None]
    block = buffer.block
    # The last block may reach beyond T: then it knows the goals at T, else the fleet does.
    total = block.goals.shape[0]
    known = jnp.where(metrics.time == timesteps, total, metrics.time)
    time = jnp.arange(timesteps + 1)
    goals = block.goals[jnp.minimum(time, total - 1)]
    goals = jnp.where((time < known)[:, None], goals, last_goal[None])
    positions = jnp.concatenate([buffer.start[None], block.positions[row]])
    remaining = jnp.concatenate([jnp.zeros_like(buffer.start)[None], block.remaining_service[row]])
    takes_part = active[None]
    return Recording(
        positions=jnp.where(takes_part, unpad(positions, cols, world.margin), 0),
        goals=jnp.where(takes_part, unpad(goals, cols, world.margin), 0),
        remaining_service=jnp.where(takes_part, remaining, 0),
        finished=block.finished[:timesteps] & driven & takes_part,
        active=active,
    )
