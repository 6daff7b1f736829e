"""PIBT: one step at a time, priorities inherited by whoever stands in the way (Okumura 2022).

Fast, and it always lets the most urgent agent move, but it looks one step ahead only. It is a
planner of its own and the last resort of the windowed planner. It must not be used to rank
layouts: it reverses the order that careful planning gives.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdenv.devices import Backend, runs_on_host
from qdenv.simulate.mapf.negotiated.rules import NOBODY
from qdenv.simulate.mapf.pibt import numba as on_host
from qdenv.simulate.mapf.planner import AgentState, World
from qdenv.types import Array

WAYS = 5  # wait, right, left, down, up


class Chain(NamedTuple):
    """The search within one timestep.

    Attributes:
        next_cell: int32 [A + 1], where each agent goes, -1 while undecided (last entry: scratch).
        claimed: int32 [H' * W' + 1], the agent that takes each cell, or `NOBODY`.
        tried: int32 [A + 1], candidates each agent has used up.
        pusher: int32 [A + 1], the agent that pushed it, or `NOBODY`.
        current: int32, the agent whose turn it is, or `NOBODY` to take the next by priority.
        rank: int32, agents taken from the priority list so far.
    """

    next_cell: Array
    claimed: Array
    tried: Array
    pusher: Array
    current: Array
    rank: Array


def one_step(
    candidates: Array, position: Array, allowed: Array, order: Array, cells: int
) -> jax.Array:
    """Move all agents by one step without conflict, in XLA; `host` has the same for a CPU.

    Args:
        candidates: int32 [A, 5], cells from best to worst; the agent's own is among them.
        position: int32 [A], distinct.
        allowed: int32 [A], how many candidates count.
        order: int32 [A], agents by falling priority.
        cells: number of cells.

    Returns:
        int32 [A], distinct, without swaps.
    """
    count = position.shape[0]
    agents = jnp.arange(count, dtype=jnp.int32)
    standing = jnp.full((cells + 1,), NOBODY, jnp.int32).at[position].set(agents)

    def visit(chain: Chain) -> Chain:
        taking = chain.current == NOBODY
        agent = jnp.where(taking, order[jnp.minimum(chain.rank, count - 1)], chain.current)
        skip = taking & (chain.next_cell[agent] != NOBODY)
        tried, pusher = chain.tried[agent], chain.pusher[agent]
        spent = tried >= allowed[agent]
        cell = candidates[agent, jnp.minimum(tried, WAYS - 1)]
        other = standing[cell]
        neighbour = jnp.maximum(other, 0)
        is_other = (other != NOBODY) & (other != agent)
        other_next = chain.next_cell[neighbour]
        swap = is_other & (other_next == position[agent])
        back = (pusher != NOBODY) & (cell == position[jnp.maximum(pusher, 0)])
        good = ~skip & ~spent & (chain.claimed[cell] == NOBODY) & ~swap & ~back
        push = good & is_other & (other_next == NOBODY)
        fail = spent & ~skip
        goes = jnp.where(good, cell, position[agent])
        settled = good | fail
        here = jnp.where(settled, agent, count)
        current = jnp.where(push, other, NOBODY)
        current = jnp.where(settled, current, jnp.where(skip, NOBODY, agent))
        current = jnp.where(fail, pusher, current)
        return Chain(
            chain.next_cell.at[here].set(jnp.where(settled, goes, NOBODY)),
            chain.claimed.at[jnp.where(settled, goes, cells)].set(
                jnp.where(settled, agent, NOBODY)
            ),
            chain.tried.at[jnp.where(skip, count, agent)].add(1),
            chain.pusher.at[jnp.where(push, other, count)].set(agent),
            current.astype(jnp.int32),
            chain.rank + taking,
        )

    blank = jnp.full((count + 1,), NOBODY, jnp.int32)
    chain = Chain(
        blank,
        jnp.full((cells + 1,), NOBODY, jnp.int32),
        jnp.zeros((count + 1,), jnp.int32),
        blank,
        jnp.int32(NOBODY),
        jnp.int32(0),
    )
    going = lambda chain: (chain.rank < count) | (chain.current != NOBODY)  # noqa: E731
    return jax.lax.while_loop(going, visit, chain).next_cell[:count]


def preferences(
    world: World, position: Array, slots: Array, fixed: Array, noise: Array
) -> tuple[jax.Array, jax.Array]:
    """Sort the five ways of every agent (candidates int32 [A, 5], number of them int32 [A]).

    Agents in `fixed` (bool [A]) can only stay.
    """
    width = world.traversable.shape[1]
    size = world.traversable.size
    cells = position[:, None] + jnp.array([0, 1, -1, width, -width])
    standing = jnp.zeros((size,), bool).at[position].set(True)
    crowded = standing[cells] & (jnp.arange(WAYS) > 0)
    to_go = world.distance.reshape(-1)[slots[:, None] * size + cells].astype(jnp.int32)
    open_cell = world.traversable.reshape(-1)[cells] & (~fixed[:, None] | (jnp.arange(WAYS) == 0))
    key = jnp.where(open_cell, (to_go << 6) | (crowded << 5) | noise, 2**28)
    best_first = jnp.argsort(key, axis=1)
    return jnp.take_along_axis(cells, best_first, axis=1), open_cell.sum(1, dtype=jnp.int32)


def rollout(
    world: World, state: AgentState, horizon: int, key: Array, backend: Backend = "auto"
) -> jax.Array:
    """Drive all agents for `horizon` steps; afterwards they wait (int32 [window + 1, A]).

    Agents that serve come first and stay; then the longer without a finished task, the earlier.
    """
    size = world.traversable.size
    count = state.position.shape[0]
    key_order, key_noise = jax.random.split(key)
    luck = jax.random.uniform(key_order, (count,))
    # Padding agents are lifted off the grid: they stand on no cell and want none.
    state_age = jnp.where(state.active, state.age, -1)
    noise = jax.random.randint(key_noise, (horizon, count, WAYS), 0, 32)
    move = on_host.one_step if runs_on_host(backend) else one_step

    def step(carry: tuple, noise: Array) -> tuple[tuple, Array]:
        position, level, serving, age = carry
        fixed = (serving > 0) | ~state.active
        slots = jnp.take_along_axis(state.goal, level[None], axis=0)[0]
        urgency = jnp.where(fixed, -jnp.inf, luck - age)
        order = jnp.argsort(urgency).astype(jnp.int32)
        candidates, allowed = preferences(world, position, slots, fixed, noise)
        position = move(candidates, position, allowed, order, size)
        stay = jnp.take_along_axis(state.service_time, level[None], axis=0)[0]
        arrived = (serving == 0) & (position == world.goals.cells[slots]) & state.active
        left = jnp.where(arrived, stay, serving - 1)
        done = (arrived | (serving > 0)) & (left <= 0)
        # The goal after the next is not known here: an agent that has done both drives on freely.
        level = jnp.minimum(level + done, 1)
        return (position, level, jnp.maximum(left, 0), jnp.where(done, 0, age + 1)), position

    level = jnp.zeros((count,), jnp.int32)
    begin = (state.position, level, state.remaining_service, state_age)
    _, cells = jax.lax.scan(step, begin, noise)
    window = state.previous.shape[0] - 1
    still = jnp.broadcast_to(cells[-1], (window - horizon, count))
    return jnp.concatenate([state.position[None], cells, still])


def wait(world: World, state: AgentState, horizon: int, key: Array) -> jax.Array:
    """Let everybody stand still, the last resort that congests as PBS does."""
    del world, horizon, key
    return jnp.broadcast_to(state.position, state.previous.shape)
