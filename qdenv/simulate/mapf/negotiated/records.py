"""What both backends are given and what they give back."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qdenv.simulate.mapf import chance
from qdenv.simulate.mapf.negotiated import rules
from qdenv.simulate.mapf.negotiated.path_rules import COST_UNIT
from qdenv.simulate.mapf.negotiated.settings import NegotiatedConfig
from qdenv.simulate.mapf.planner import AgentState


class PlanResult(NamedTuple):
    """What a negotiation ends with."""

    paths: jax.Array  # int32 [window + 1, A]. Those that are reserved never conflict.
    is_reserved: jax.Array  # bool [A], whose path is reserved; all padding agents count as such


class Priorities(NamedTuple):
    """What chance decides."""

    order: jax.Array  # int32 [A], who comes first among agents with equally many attempts
    noise: jax.Array  # int32 [A], 24 bits that settle ties between paths


def draw_priorities(state: AgentState, seed: jax.Array) -> Priorities:
    """Draw the agents' order and the bits that settle ties."""
    count = state.position.shape[0]
    order_bits, tie_bits = (
        chance.draw_many(chance.draw(seed, purpose), count)
        for purpose in (chance.ORDER, chance.TIES)
    )
    turn = jnp.argsort(rules.luck(order_bits, state.remaining_service > 0))
    order = jnp.zeros((count,), jnp.int32).at[turn].set(jnp.arange(count, dtype=jnp.int32))
    return Priorities(order, rules.noise_of(tie_bits).astype(jnp.int32))


def penalty_costs(config: NegotiatedConfig) -> np.ndarray:
    """Put the penalties in units of costs (int32 [attempts])."""
    return np.array([round(COST_UNIT * penalty) for penalty in config.penalties], np.int32)


def planned_ahead(config: NegotiatedConfig, window: int, horizon: int) -> int:
    """Count the timesteps planned without conflict."""
    return max(horizon, min(config.lookahead, window))


def lanes_of(config: NegotiatedConfig, agents: int) -> int:
    """Count the agents that plan in one round."""
    return min(config.lanes, agents)


def count_rounds(config: NegotiatedConfig, agents: jax.Array | int) -> jax.Array | np.floating:
    """Limit the rounds of so many agents. Padding takes no part: it must not change them."""
    return np.float32(config.rounds) * -(-agents // config.lanes)
