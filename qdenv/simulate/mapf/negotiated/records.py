"""What both backends are given and what they give back."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qdenv.simulate.mapf.negotiated.path_rules import COST_UNIT
from qdenv.simulate.mapf.negotiated.settings import NegotiatedConfig
from qdenv.simulate.mapf.planner import AgentState


class PlanResult(NamedTuple):
    """What a negotiation ends with.

    Attributes:
        paths: int32 [window + 1, A]. Those that are reserved never conflict.
        is_reserved: bool [A], whose path is reserved; all padding agents count as such.
    """

    paths: jax.Array
    is_reserved: jax.Array


class Priorities(NamedTuple):
    """What chance decides.

    Attributes:
        order: int32 [A], who comes first among agents with equally many attempts.
        noise: int32 [A], 24 bits that settle ties between paths.
    """

    order: jax.Array
    noise: jax.Array


def draw_priorities(state: AgentState, key: jax.Array) -> Priorities:
    """Draw the agents' order and the bits that settle ties; consumes the key."""
    order_key, noise_key = jax.random.split(key)
    count = state.position.shape[0]
    luck = jax.random.uniform(order_key, (count,))
    # Agents that serve cannot give way: the others had better know of them first.
    turn = jnp.argsort(luck - (state.remaining_service > 0))
    order = jnp.zeros((count,), jnp.int32).at[turn].set(jnp.arange(count, dtype=jnp.int32))
    noise = jax.random.bits(noise_key, (count,), jnp.uint32).astype(jnp.int32) & 0xFFFFFF
    return Priorities(order, noise)


def penalty_costs(config: NegotiatedConfig) -> np.ndarray:
    """Put the penalties in units of costs (int32 [attempts])."""
    return np.array([round(COST_UNIT * penalty) for penalty in config.penalties], np.int32)


def round_limit(config: NegotiatedConfig, state: AgentState) -> jax.Array:
    """Limit the rounds (int32). Padding takes no part: it must not change what others get."""
    lanes = min(config.lanes, state.position.shape[0])
    crowd = -(-state.active.sum() // lanes)
    return (config.rounds * crowd).astype(jnp.int32)
