"""Proximal policy optimisation of the recurrent maze agent (Schulman et al. 2017)."""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import optax

from qdenv.agent.rollout import Step
from qdenv.simulate.maze.policy import Memory, Weights, act, assess, encode, recur
from qdenv.simulate.maze.world import image
from qdenv.types import Array


@dataclass(frozen=True)
class PPOConfig:
    """Numbers of the algorithm.

    Attributes:
        lanes: environments that run side by side.
        timesteps: steps of one rollout; gradients flow through all of them.
        epochs: passes over a rollout.
        minibatches: groups of lanes per pass.
        clip: range of the probability ratio.
        discount: gamma.
        trace: lambda of the advantage estimate.
        critic: weight of the value loss.
    """

    lanes: int = 256
    timesteps: int = 128
    epochs: int = 2
    minibatches: int = 4
    clip: float = 0.2
    discount: float = 0.995
    trace: float = 0.95
    critic: float = 0.5


class Batch(NamedTuple):
    """A rollout ready for learning; leading axes [T, lanes] but for the memory."""

    steps: Step
    memory: Memory  # before the first step, [lanes, L]
    gain: Array  # float32, advantages
    target: Array  # float32, returns


def advantages(steps: Step, last_value: Array, config: PPOConfig) -> jax.Array:
    """Estimate advantages backwards in time (GAE); steps [T, lanes] -> float32 [T, lanes]."""

    def back(carry: tuple[Array, Array], now: Step) -> tuple[tuple[Array, Array], Array]:
        later, value = carry
        alive = 1.0 - now.done
        surprise = now.reward + config.discount * alive * value - now.value
        estimate = surprise + config.discount * config.trace * alive * later
        return (estimate, now.value), estimate

    zero = jnp.zeros_like(last_value)
    return jax.lax.scan(back, (zero, last_value), steps, reverse=True)[1]


def replay(weights: Weights, steps: Step, memory: Memory) -> Array:
    """Run the network over recorded steps [T, lanes] -> hidden states [T, lanes, L]."""
    gates = encode(weights, image(steps.view), jax.nn.one_hot(steps.heading, 4))

    def one(memory: Memory, now: tuple[Array, Array]) -> tuple[Memory, Array]:
        gates, fresh = now
        keep = 1.0 - fresh[:, None]
        memory = recur(weights, gates, Memory(memory.hidden * keep, memory.cell * keep))
        return memory, memory.hidden

    return jax.lax.scan(one, memory, (gates, steps.fresh))[1]


def loss(
    weights: Weights, batch: Batch, clip: float, critic: float, entropy: Array
) -> tuple[Array, Array]:
    """Compute the clipped surrogate loss, and (entropy, divergence, value error) for the log."""
    hidden = replay(weights, batch.steps, batch.memory)
    logs = jax.nn.log_softmax(act(weights, hidden))
    taken = jnp.take_along_axis(logs, batch.steps.action[..., None], -1)[..., 0]
    change = taken - batch.steps.log_prob
    ratio = jnp.exp(change)
    bounded = jnp.clip(ratio, 1 - clip, 1 + clip)
    surrogate = -jnp.minimum(ratio * batch.gain, bounded * batch.gain).mean()
    miss = jnp.square(assess(weights, hidden) - batch.target).mean()
    spread = -(jnp.exp(logs) * logs).sum(-1).mean()
    total = surrogate + critic * miss - entropy * spread
    return total, jnp.stack([spread, ((ratio - 1) - change).mean(), miss])


def learn(
    key: Array,
    weights: Weights,
    optimiser: optax.GradientTransformation,
    state: optax.OptState,
    batch: Batch,
    config: PPOConfig,
    entropy: Array,
) -> tuple[Weights, optax.OptState, Array]:
    """Improve the weights on one rollout; consumes the key.

    Returns:
        weights, optimiser state, log (entropy, divergence, value error).
    """
    gain = (batch.gain - batch.gain.mean()) / (batch.gain.std() + 1e-8)
    batch = batch._replace(gain=gain)

    def one(carry: tuple[Weights, optax.OptState], lanes: Array):
        weights, state = carry
        part = jax.tree.map(lambda x: x[:, lanes], batch._replace(memory=()))
        part = part._replace(memory=jax.tree.map(lambda x: x[lanes], batch.memory))
        grads, log = jax.grad(loss, has_aux=True)(
            weights, part, config.clip, config.critic, entropy
        )
        updates, state = optimiser.update(grads, state, weights)
        return (optax.apply_updates(weights, updates), state), log

    keys = jax.random.split(key, config.epochs)
    order = jax.vmap(lambda k: jax.random.permutation(k, config.lanes))(keys)
    order = order.reshape(config.epochs * config.minibatches, -1)
    (weights, state), log = jax.lax.scan(one, (weights, state), order)
    return weights, state, log.mean(0)
