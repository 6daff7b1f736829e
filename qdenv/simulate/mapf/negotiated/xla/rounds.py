"""Rounds of negotiation in XLA, for accelerators: a few agents plan side by side in each.

`numba.rounds` does the same on one core of the host, with the same result to the bit.
"""

from typing import TypeAlias

import jax
import jax.numpy as jnp

from qdenv.simulate.mapf import chance
from qdenv.simulate.mapf.negotiated import rules
from qdenv.simulate.mapf.negotiated.settings import NegotiatedConfig
from qdenv.simulate.mapf.negotiated.xla.reservations import (
    Reservations,
    accept,
    begin,
    pack,
    release,
)
from qdenv.simulate.mapf.negotiated.xla.search import find_paths, gather
from qdenv.simulate.mapf.planner import AgentState, World

# Between two rounds: the reservations, how often each agent has planned in this window (int32 [A]),
# and the number of rounds so far.
_Negotiation: TypeAlias = tuple[Reservations, jax.Array, jax.Array]


def negotiate(
    config: NegotiatedConfig, world: World, state: AgentState, horizon: int, seed: jax.Array
) -> Reservations:
    """Run rounds of planning until all agents hold a reservation or the rounds are used up.

    The length of the agents' previous paths is the window; `horizon` timesteps will be driven.
    """
    shape = (world.traversable.shape[0], world.traversable.shape[1])
    window, count = state.previous.shape[0] - 1, state.position.shape[0]
    lanes = config.num_lanes(count)
    order, tie_breaks = _draw_priorities(state, seed)
    walls = pack(world.traversable)
    penalties = jnp.asarray(config.penalty_costs(rules.COST_UNIT))
    limit = jnp.asarray(config.max_rounds(state.active.sum())).astype(jnp.int32)

    def plan_round(negotiation: _Negotiation) -> _Negotiation:
        reservations, attempts, turn = negotiation
        urgency = rules.urgency(order, attempts, count)
        # Always as many lanes as compiled for: with fewer agents left, some of those that hold a
        # reservation fill them up, and plan in vain.
        agent = _smallest(jnp.where(reservations.is_reserved, 2**30, urgency), lanes)
        plans = ~reservations.is_reserved[agent]
        planning = jnp.where(plans, agent, count)
        if config.remember:  # else no agent that plans has reserved anything
            reservations = release(reservations, shape, planning)
        penalty = penalties[rules.penalty_index(attempts[agent], penalties.size)]
        tie_break = rules.tie_break_of_round(tie_breaks[agent], turn)
        local = gather(world, state, reservations.table, walls, agent, penalty, tie_break)
        steps, cost = find_paths(local, config.conflict_levels)
        paths = state.position[agent] + steps[0] * shape[1] + steps[1]
        found = plans & (cost < rules.INFEASIBLE)
        chosen = choose(path_conflicts(paths, paths), found)
        reservations = accept(reservations, shape, agent, paths, chosen)
        return reservations, attempts.at[planning].add(1, mode="drop"), turn + 1

    remembered = begin(state, shape, window - horizon if config.remember else 0)
    return jax.lax.while_loop(
        lambda negotiation: (negotiation[2] < limit) & ~negotiation[0].is_reserved.all(),
        plan_round,
        (remembered, jnp.zeros((count,), jnp.int32), jnp.int32(0)),
    )[0]


def _draw_priorities(state: AgentState, seed: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Draw the agents' order, and 24 bits that settle ties between paths (int32 [A] each)."""
    count = state.position.shape[0]
    order_bits, tie_bits = (
        chance.draw_many(chance.draw(seed, purpose), count)
        for purpose in (chance.ORDER, chance.TIES)
    )
    turn = jnp.argsort(rules.random_rank(order_bits, state.remaining_service > 0))
    order = jnp.zeros((count,), jnp.int32).at[turn].set(jnp.arange(count, dtype=jnp.int32))
    return order, rules.tie_break_of(tie_bits).astype(jnp.int32)


def _smallest(keys: jax.Array, count: int) -> jax.Array:
    """Find the indices of the `count` smallest keys (int32 [A]); a fifth of the time of top_k."""

    def take(keys: jax.Array, _: None) -> tuple[jax.Array, jax.Array]:
        index = jnp.argmin(keys)
        return keys.at[index].set(jnp.iinfo(keys.dtype).max), index

    return jax.lax.scan(take, keys, None, length=count)[1]


def path_conflicts(ours: jax.Array, theirs: jax.Array) -> jax.Array:
    """Find pairs of paths with a vertex or swap conflict (int32 [t+1, A], [t+1, B] -> bool [A, B]).

    The common first row is where the agents stand and is not tested.
    """
    a, b = ours[:, :, None], theirs[:, None, :]
    return rules.steps_conflict(a[:-1], a[1:], b[:-1], b[1:]).any(0)


def choose(conflicts: jax.Array, candidates: jax.Array) -> jax.Array:
    """Choose candidates (bool [K]) that conflict (bool [K, K]) with no earlier chosen one.

    The greedy choice in `rules.SWEEPS` sweeps over all at once.
    """
    count = candidates.shape[0]
    earlier = conflicts & (jnp.arange(count)[:, None] > jnp.arange(count)[None, :])
    chosen = candidates
    for _ in range(rules.SWEEPS):
        chosen = candidates & ~(earlier & chosen[None, :]).any(1)
    return chosen
