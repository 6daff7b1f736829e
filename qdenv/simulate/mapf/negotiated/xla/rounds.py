"""Rounds of negotiation in XLA, for accelerators: a few agents plan side by side in each.

`numba.rounds` does the same on one core of the host, with the same result to the bit.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdenv.simulate.mapf import chance
from qdenv.simulate.mapf.negotiated import path_rules, rules
from qdenv.simulate.mapf.negotiated.settings import NegotiatedConfig
from qdenv.simulate.mapf.negotiated.xla.observation import Planning, gather
from qdenv.simulate.mapf.negotiated.xla.reservations import (
    Accepted,
    Reservations,
    evict,
    no_reservations,
    pack,
    release,
    remember,
    reserve,
)
from qdenv.simulate.mapf.negotiated.xla.search import find_paths
from qdenv.simulate.mapf.planner import AgentState, World


class PlanResult(NamedTuple):
    """What a negotiation ends with."""

    paths: jax.Array  # int32 [window + 1, A]. Those that are reserved never conflict.
    is_reserved: jax.Array  # bool [A], whose path is reserved; all padding agents count as such


class Priorities(NamedTuple):
    """What chance decides."""

    order: jax.Array  # int32 [A], who comes first among agents with equally many attempts
    tie_break: jax.Array  # int32 [A], 24 bits that settle ties between paths


def draw_priorities(state: AgentState, seed: jax.Array) -> Priorities:
    """Draw the agents' order and the bits that settle ties."""
    count = state.position.shape[0]
    order_bits, tie_bits = (
        chance.draw_many(chance.draw(seed, purpose), count)
        for purpose in (chance.ORDER, chance.TIES)
    )
    turn = jnp.argsort(rules.random_rank(order_bits, state.remaining_service > 0))
    order = jnp.zeros((count,), jnp.int32).at[turn].set(jnp.arange(count, dtype=jnp.int32))
    return Priorities(order, rules.tie_break_of(tie_bits).astype(jnp.int32))


class Negotiation(NamedTuple):
    """What changes from round to round."""

    reservations: Reservations  # of all agents
    attempts: jax.Array  # int32 [A], how often each agent has planned in this window
    turn: jax.Array  # int32, rounds so far


def negotiate(
    config: NegotiatedConfig, world: World, state: AgentState, horizon: int, seed: jax.Array
) -> PlanResult:
    """Run rounds of planning until everybody holds a reservation or the rounds are used up.

    Args:
        config: of the planner.
        world: the layout.
        state: the agents; the length of its previous paths is the window.
        horizon: timesteps that will be driven.
        seed: of all that is drawn.
    """
    shape = (world.traversable.shape[0], world.traversable.shape[1])
    window, count = state.previous.shape[0] - 1, state.position.shape[0]
    lanes = config.num_lanes(count)
    priorities = draw_priorities(state, seed)
    walls = pack(world.traversable)
    penalties = jnp.asarray(config.penalty_costs(path_rules.COST_UNIT))
    limit = jnp.asarray(config.max_rounds(state.active.sum())).astype(jnp.int32)

    def find(negotiation: Negotiation, agent: jax.Array) -> tuple[jax.Array, jax.Array]:
        attempt = rules.penalty_index(negotiation.attempts[agent], penalties.size)
        tie_break = rules.tie_break_of_round(priorities.tie_break[agent], negotiation.turn)
        who = Planning(agent, penalties[attempt], tie_break)
        local = gather(world, state, negotiation.reservations.table, walls, who)
        steps, cost = find_paths(local, config.conflict_levels)
        paths = state.position[agent] + steps[0] * shape[1] + steps[1]
        return paths, cost < path_rules.INFEASIBLE

    def plan_round(negotiation: Negotiation) -> Negotiation:
        reservations, attempts, turn = negotiation
        urgency = rules.urgency(priorities.order, attempts, count)
        # Always as many lanes as compiled for: with fewer agents left, idle ones fill up and do not
        # ask, for what has no reservation to release or to enter changes nothing.
        agent = smallest(jnp.where(reservations.is_reserved, 2**30, urgency), lanes)
        asks = ~reservations.is_reserved[agent]
        asking = jnp.where(asks, agent, count)
        if config.remember:  # else nobody who asks has reserved anything
            reservations = release(reservations, shape, asking)
        paths, found = find(negotiation._replace(reservations=reservations), agent)
        chosen = choose(path_conflicts(paths, paths), asks & found)
        accepted = Accepted(agent, paths, chosen)
        # All evictions before all entries: a bit has one owner, so it must be free when it is set.
        reservations = reserve(evict(reservations, shape, accepted), shape, accepted)
        return Negotiation(reservations, attempts.at[asking].add(1, mode="drop"), turn + 1)

    def is_open(negotiation: Negotiation) -> jax.Array:
        return (negotiation.turn < limit) & ~negotiation.reservations.is_reserved.all()

    reservations = no_reservations(state, shape)
    if config.remember:
        reservations = remember(reservations, state, shape, window - horizon)
    begin = Negotiation(reservations, jnp.zeros((count,), jnp.int32), jnp.int32(0))
    reservations = jax.lax.while_loop(is_open, plan_round, begin).reservations
    return PlanResult(reservations.paths, reservations.is_reserved)


def smallest(keys: jax.Array, count: int) -> jax.Array:
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
