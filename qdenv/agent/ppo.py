"""Proximal policy optimisation of the recurrent maze agent.

Schulman et al. 2017, "Proximal policy optimization algorithms", https://arxiv.org/abs/1707.06347;
advantages by Schulman et al. 2016, "High-dimensional continuous control using generalized advantage
estimation", https://arxiv.org/abs/1506.02438; the anchor by Schmitt et al. 2018, "Kickstarting deep
reinforcement learning", https://arxiv.org/abs/1803.03835.
"""

from typing import NamedTuple

import chex
import jax
import jax.numpy as jnp
import optax

from qdenv.agent.rollout import Transition
from qdenv.agent.settings import PPOConfig
from qdenv.simulate.maze.policy import Memory, Weights, act, encode, estimate_value, recur
from qdenv.simulate.maze.world import image


class Batch(NamedTuple):
    """A rollout ready for learning; leading axes [T, E] but for the memory."""

    steps: Transition
    memory: Memory  # before the first step, [E, L]
    advantage: jax.Array  # float32
    returns: jax.Array  # float32, targets of the value
    anchored: jax.Array  # float32 [T, E, N], log probabilities of the anchor; N is 0 without one


class LearningLog(NamedTuple):
    """What one pass of learning tells, float32 each."""

    policy_entropy: jax.Array  # mean over steps, in nats
    approx_kl: jax.Array  # estimate of the divergence of the new policy from the old one
    value_loss: jax.Array  # mean squared error of the value


def advantages(steps: Transition, last_value: jax.Array, config: PPOConfig) -> jax.Array:
    """Estimate advantages backwards in time (GAE); steps [T, E] -> float32 [T, E]."""
    chex.assert_shape(last_value, steps.reward.shape[1:])
    gae_lambda = config.trace

    def back(
        carry: tuple[jax.Array, jax.Array], now: Transition
    ) -> tuple[tuple[jax.Array, jax.Array], jax.Array]:
        next_advantage, next_value = carry
        alive = 1.0 - now.done
        td_error = now.reward + config.discount * alive * next_value - now.value
        advantage = td_error + config.discount * gae_lambda * alive * next_advantage
        return (advantage, now.value), advantage

    start = jnp.zeros_like(last_value), last_value
    return jax.lax.scan(back, start, steps, reverse=True)[1]


def unroll(weights: Weights, steps: Transition, memory: Memory) -> tuple[Memory, jax.Array]:
    """Run the network over recorded steps [T, E] -> last memory, hidden states [T, E, L]."""
    # All observations are known: only the recurrence itself has to wait for the step before.
    gates = encode(weights, image(steps.view), jax.nn.one_hot(steps.heading, 4))

    def one(memory: Memory, now: tuple[jax.Array, jax.Array]) -> tuple[Memory, jax.Array]:
        gates, fresh = now
        keep = 1.0 - fresh[:, None]
        memory = recur(weights, gates, Memory(memory.hidden * keep, memory.cell * keep))
        return memory, jnp.asarray(memory.hidden)

    return jax.lax.scan(one, memory, (gates, steps.fresh))


def loss(
    weights: Weights, batch: Batch, config: PPOConfig, entropy: jax.Array, anchor: float = 0.0
) -> tuple[jax.Array, LearningLog]:
    """Compute the clipped surrogate loss of PPO, and numbers for the log."""
    clip, critic = config.clip, config.critic
    _, hidden = unroll(weights, batch.steps, batch.memory)
    log_probs = jax.nn.log_softmax(act(weights, hidden))
    taken = jnp.take_along_axis(log_probs, batch.steps.action[..., None], -1)[..., 0]
    log_ratio = taken - batch.steps.log_prob
    ratio = jnp.exp(log_ratio)
    clipped = jnp.clip(ratio, 1 - clip, 1 + clip)
    # The smaller of both: an action may lose its advantage without bound but gain only so much.
    surrogate = -jnp.minimum(ratio * batch.advantage, clipped * batch.advantage).mean()
    value_loss = jnp.square(estimate_value(weights, hidden) - batch.returns).mean()
    policy_entropy = -(jnp.exp(log_probs) * log_probs).sum(-1).mean()
    total = surrogate + critic * value_loss - entropy * policy_entropy
    if anchor:
        known = batch.anchored
        total += anchor * (jnp.exp(known) * (known - log_probs)).sum(-1).mean()
    # (r - 1) - log r is never negative and has the divergence as its mean.
    return total, LearningLog(policy_entropy, ((ratio - 1) - log_ratio).mean(), value_loss)


def learn(
    key: jax.Array,
    weights: Weights,
    optimiser: optax.GradientTransformation,
    state: optax.OptState,
    batch: Batch,
    config: PPOConfig,
    entropy: jax.Array,
    anchor: float = 0.0,
) -> tuple[Weights, optax.OptState, LearningLog]:
    """Improve the weights on one rollout; consumes the key.

    Returns:
        weights, optimiser state, log (means over the minibatches).
    """
    advantage = (batch.advantage - batch.advantage.mean()) / (batch.advantage.std() + 1e-8)
    batch = batch._replace(advantage=advantage)

    def one(
        carry: tuple[Weights, optax.OptState], envs: jax.Array
    ) -> tuple[tuple[Weights, optax.OptState], LearningLog]:
        weights, state = carry
        memory = jax.tree.map(lambda x: x[envs], batch.memory)
        columns = batch.steps, batch.advantage, batch.returns, batch.anchored
        steps, *others = jax.tree.map(lambda x: x[:, envs], columns)
        part = Batch(steps, memory, *others)
        grads, log = jax.grad(loss, has_aux=True)(weights, part, config, entropy, anchor)
        updates, state = optimiser.update(grads, state, weights)
        return (optax.apply_updates(weights, updates), state), log

    # Minibatches of whole environments: the recurrent state must run through every rollout.
    keys = jax.random.split(key, config.epochs)
    order = jax.vmap(lambda k: jax.random.permutation(k, config.lanes))(keys)
    order = order.reshape(config.epochs * config.minibatches, -1)
    (weights, state), log = jax.lax.scan(one, (weights, state), order)
    return weights, state, jax.tree.map(lambda numbers: numbers.mean(0), log)
