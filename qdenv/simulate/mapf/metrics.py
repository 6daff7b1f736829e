"""What is counted and kept while a fleet drives: tasks, cell usage, jams, whole recordings."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdenv.simulate.mapf.negotiated.settings import MARGIN
from qdenv.simulate.mapf.planner import World
from qdenv.types import Array, Traffic


def walled(cells: Array, cols: int) -> jax.Array:
    """Translate positions of the layout into positions of the walled grid."""
    return (cells // cols + MARGIN) * (cols + 2 * MARGIN) + cells % cols + MARGIN


def unwalled(cells: Array, cols: int) -> jax.Array:
    """Translate positions of the walled grid into positions of the layout."""
    width = cols + 2 * MARGIN
    return (cells // width - MARGIN) * cols + cells % width - MARGIN


class Block(NamedTuple):
    """What happened in the executed steps of one window, each [h, A]."""

    positions: Array  # int32, after the step
    serving: Array  # int32, after the step
    finished: Array  # bool
    goals: Array  # int32, goal cells before the step


class Tally(NamedTuple):
    """What was counted so far; T is rounded up to whole windows."""

    time: Array  # int32
    congested: Array  # bool
    finished: Array  # int32 [T]
    visits: Array  # int32 [H' * W']
    moves: Array  # int32


def empty_tally(world: World, timesteps: int) -> Tally:
    """Begin to count."""
    return Tally(
        time=jnp.int32(0),
        congested=jnp.bool_(False),
        finished=jnp.zeros((timesteps,), jnp.int32),
        visits=jnp.zeros((world.traversable.size,), jnp.int32),
        moves=jnp.int32(0),
    )


class Recording(NamedTuple):
    """A whole run, for the audit and for pictures; positions on the layout without margin.

    Attributes:
        positions: int32 [T + 1, A]; after the end of the run the last position is repeated.
        goals: int32 [T + 1, A], the goal cell each agent is heading for before the step.
        serving: int32 [T + 1, A], timesteps it must still stay.
        finished: bool [T, A], tasks finished by the step.
        active: bool [A].
    """

    positions: Array
    goals: Array
    serving: Array
    finished: Array
    active: Array


def is_congested(start: Array, block: Block, serving: Array, active: Array) -> jax.Array:
    """Tell whether more than half of the agents are stuck.

    Stuck: the same cell at all timesteps of the window but the last, and never serving.
    """
    path = jnp.concatenate([start[None], block.positions])[:-1]
    at_work = jnp.concatenate([serving[None], block.serving])[:-1] > 0
    stuck = (path == path[0]).all(0) & ~at_work.any(0) & active
    return stuck.sum() > active.sum() // 2


def count_block(tally: Tally, start: Array, block: Block, active: Array, timesteps: int) -> Tally:
    """Add the driven steps to the tally; steps beyond T do not count."""
    horizon = block.positions.shape[0]
    counts = (tally.time + jnp.arange(horizon) < timesteps)[:, None] & active[None, :]
    before = jnp.concatenate([start[None], block.positions[:-1]])
    finished = (block.finished & counts).sum(1, dtype=jnp.int32)
    return Tally(
        time=jnp.minimum(tally.time + horizon, timesteps),
        congested=tally.congested,
        finished=jax.lax.dynamic_update_slice(tally.finished, finished, (tally.time,)),
        visits=tally.visits.at[block.positions].add(counts.astype(jnp.int32)),
        moves=tally.moves + ((block.positions != before) & counts).sum(dtype=jnp.int32),
    )


def summarise(world: World, tally: Tally, active: Array, timesteps: int) -> Traffic:
    """Turn the tally into the record that other stages read."""
    finished = tally.finished[:timesteps]
    visits = tally.visits.reshape(world.traversable.shape)[MARGIN:-MARGIN, MARGIN:-MARGIN]
    steps = jnp.maximum(tally.time * active.sum(), 1).astype(jnp.float32)
    total = finished.sum()
    return Traffic(
        throughput=total / jnp.float32(timesteps),
        congested=tally.congested | ~world.valid,
        end_timestep=tally.time,
        finished=finished,
        usage=visits / jnp.maximum(visits.sum(), 1).astype(jnp.float32),
        waiting=1.0 - tally.moves / steps,
        path_length=tally.moves / jnp.maximum(total, 1).astype(jnp.float32),
    )


class Tape(NamedTuple):
    """All blocks of a run so far, and where the agents began."""

    begin: Array  # int32 [A]
    block: Block  # each [T, A]

    @classmethod
    def empty(cls, begin: Array, timesteps: int) -> "Tape":
        """Make a tape for `timesteps` steps of agents that begin at `begin` (int32 [A])."""
        blank = jnp.zeros((timesteps, begin.shape[0]), jnp.int32)
        return cls(begin, Block(blank, blank, blank, blank))

    def store(self, block: Block, time: Array) -> "Tape":
        """Write a block at its time."""

        def write(roll: Array, part: Array) -> jax.Array:
            return jax.lax.dynamic_update_slice(roll, part.astype(jnp.int32), (time, 0))

        return self._replace(block=jax.tree.map(write, self.block, block))


def recording_of(
    tape: Tape, tally: Tally, last_goal: Array, active: Array, world: World, timesteps: int
) -> Recording:
    """Cut the tape to T steps and translate its positions; nothing moves after the end."""
    cols = world.traversable.shape[1] - 2 * MARGIN
    last = jnp.maximum(tally.time - 1, 0)
    row = jnp.minimum(jnp.arange(timesteps), last)
    driven = (jnp.arange(timesteps) < tally.time)[:, None]
    block = tape.block
    # The last block may reach beyond T: then it knows the goals at T, else the fleet does.
    total = block.goals.shape[0]
    known = jnp.where(tally.time == timesteps, total, tally.time)
    time = jnp.arange(timesteps + 1)
    goals = block.goals[jnp.minimum(time, total - 1)]
    goals = jnp.where((time < known)[:, None], goals, last_goal)
    return Recording(
        positions=unwalled(jnp.concatenate([tape.begin[None], block.positions[row]]), cols),
        goals=unwalled(goals, cols),
        serving=jnp.concatenate([jnp.zeros_like(tape.begin)[None], block.serving[row]]),
        finished=(block.finished[:timesteps] > 0) & driven,
        active=active,
    )
