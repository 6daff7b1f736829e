"""One timestep of PIBT as one loop without callbacks: each turn of it tries one candidate.

The rules are those of `rules`; `numba` is the same algorithm in the form a person reads.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdenv.grid import NUM_MOVES
from qdenv.simulate.mapf.pibt.rules import is_admissible, is_pushed
from qdenv.simulate.mapf.planner import NOBODY


class _Crowd(NamedTuple):
    """What does not change within one timestep."""

    candidates: jax.Array  # int32 [A, 5], cells from best to worst
    allowed: jax.Array  # int32 [A], how many candidates count
    order: jax.Array  # int32 [A], agents by falling priority
    position: jax.Array  # int32 [A + 1], where the agents stand; the last entry is `NOBODY`
    standing: jax.Array  # int32 [H' * W' + 1], the agent on each cell, or `NOBODY`


class Chain(NamedTuple):
    """The search within one timestep; the last entry of every array belongs to `NOBODY`."""

    next_cell: jax.Array  # int32 [A + 1], where each agent goes, `NOBODY` while undecided
    claimant: jax.Array  # int32 [H' * W' + 1], the agent that takes each cell, or `NOBODY`
    tried: jax.Array  # int32 [A + 1], candidates each agent has used up
    pusher: jax.Array  # int32 [A + 1], the agent that pushed it, or `NOBODY`
    # int32, the agent whose turn it is, or `NOBODY` to take the next by priority
    current: jax.Array
    rank: jax.Array  # int32, agents taken from the priority list so far


def one_step(
    candidates: jax.Array, position: jax.Array, allowed: jax.Array, order: jax.Array, cells: int
) -> jax.Array:
    """Move all agents by one step without conflict.

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
    nobody = jnp.full((count + 1,), NOBODY, jnp.int32)
    on_no_cell = jnp.full((cells + 1,), NOBODY, jnp.int32)
    standing = on_no_cell.at[position].set(jnp.arange(count, dtype=jnp.int32))
    crowd = _Crowd(candidates, allowed, order, nobody.at[:count].set(position), standing)
    first = Chain(
        next_cell=nobody,
        claimant=on_no_cell,
        tried=jnp.zeros((count + 1,), jnp.int32),
        pusher=nobody,
        current=jnp.int32(NOBODY),
        rank=jnp.int32(0),
    )

    def going(chain: Chain) -> jax.Array:
        return (chain.rank < count) | (chain.current != NOBODY)

    return jax.lax.while_loop(going, lambda chain: _visit(crowd, chain), first).next_cell[:count]


def _visit(crowd: _Crowd, chain: Chain) -> Chain:
    """Let the agent whose turn it is try its next candidate.

    Index `NOBODY` (-1) reads the last entry of an array, which says `NOBODY` again; so no rule
    needs a mask.
    """
    taking = chain.current == NOBODY
    last = crowd.order.shape[0] - 1
    agent = jnp.where(taking, crowd.order[jnp.minimum(chain.rank, last)], chain.current)
    skip = taking & (chain.next_cell[agent] != NOBODY)  # it was pushed before its own turn
    tried, pusher = chain.tried[agent], chain.pusher[agent]
    spent = tried >= crowd.allowed[agent]
    cell = crowd.candidates[agent, jnp.minimum(tried, NUM_MOVES - 1)]
    other = crowd.standing[cell]
    other_next = chain.next_cell[other]
    here, behind = crowd.position[agent], crowd.position[pusher]
    free = is_admissible(cell, here, chain.claimant[cell], other_next, behind)
    good = ~skip & ~spent & free
    fail = ~skip & spent  # nowhere to go: stay, and let the pusher try on
    push = good & is_pushed(other, agent, other_next)
    follower = jnp.where(good | skip, NOBODY, agent)
    follower = jnp.where(push, other, jnp.where(fail, pusher, follower))
    chain = chain._replace(
        tried=chain.tried.at[jnp.where(skip, NOBODY, agent)].add(1),
        pusher=chain.pusher.at[jnp.where(push, other, NOBODY)].set(agent),
        current=follower.astype(jnp.int32),
        rank=chain.rank + taking,
    )
    return _settle(chain, good | fail, agent, jnp.where(good, cell, here))


def _settle(chain: Chain, settled: jax.Array, agent: jax.Array, cell: jax.Array) -> Chain:
    """Write down, where `settled`, that `agent` takes `cell`; else write to nobody's entries."""
    return chain._replace(
        next_cell=chain.next_cell.at[jnp.where(settled, agent, NOBODY)].set(
            jnp.where(settled, cell, NOBODY)
        ),
        claimant=chain.claimant.at[jnp.where(settled, cell, NOBODY)].set(
            jnp.where(settled, agent, NOBODY)
        ),
    )
