"""Let the agent play training levels side by side and record what it did."""

from collections.abc import Callable
from typing import NamedTuple

import chex
import jax
import jax.numpy as jnp
import optax

from qdenv.agent.levels import Level
from qdenv.agent.settings import PPOConfig
from qdenv.simulate.maze.episode import choose
from qdenv.simulate.maze.policy import (
    Memory,
    Weights,
    act,
    blank_memory,
    encode,
    estimate_value,
    recur,
)
from qdenv.simulate.maze.world import Pose, image, step, view


class Rewards(NamedTuple):
    """`RewardConfig` at one moment of the training."""

    novelty: jax.Array | float
    progress: float
    haste: float


class EnvState(NamedTuple):
    """One environment under way."""

    level: Level
    slot: jax.Array  # int32, the level's place in the buffer
    serial: jax.Array  # int32, tells whether the buffer still holds this level
    pose: Pose
    memory: Memory
    visited: jax.Array  # bool, tiles trodden in this episode
    elapsed: jax.Array  # int32, actions taken


class Transition(NamedTuple):
    """What one step leaves behind for learning."""

    view: jax.Array  # int8 [5, 5]
    heading: jax.Array  # int32
    fresh: jax.Array  # bool, the memory was blank before this step
    action: jax.Array  # int32
    log_prob: jax.Array  # float32
    value: jax.Array  # float32
    reward: jax.Array  # float32
    done: jax.Array  # bool, the episode ended with this step
    success: jax.Array  # bool, at the goal
    longest: jax.Array  # bool, on a longest-path pair
    slot: jax.Array  # int32, the level's place in the buffer
    serial: jax.Array  # int32, the level's number


def reset_env(
    weights: Weights, level: Level, slot: jax.Array, serial: jax.Array, heading: jax.Array
) -> EnvState:
    """Put the agent at the start of a level."""
    return EnvState(
        level=level,
        slot=slot,
        serial=serial,
        pose=Pose(level.start, heading),
        memory=blank_memory(weights),
        visited=jnp.zeros(level.distance.shape, bool).at[level.start].set(True),
        elapsed=jnp.int32(0),
    )


def _step_env(
    weights: Weights, env: EnvState, draw: jax.Array, rewards: Rewards
) -> tuple[EnvState, Transition]:
    """Act once in one environment, without starting over when the episode ends.

    Args:
        weights: the agent.
        env: the environment.
        draw: float32 in [0, 1), decides the action.
        rewards: what is rewarded beside the goal.
    """
    level, heading = env.level, jnp.asarray(env.pose.heading)
    seen = view(level.kinds, env.pose.position, heading)
    facing = jax.nn.one_hot(heading, 4)
    memory = recur(weights, encode(weights, image(seen), facing), env.memory)
    logits = act(weights, memory.hidden)
    action = choose(logits, draw)
    pose, success = step(level.kinds, env.pose, action)
    elapsed = env.elapsed + 1
    taken = Transition(
        view=seen,
        heading=heading,
        fresh=env.elapsed == 0,
        action=action,
        log_prob=jax.nn.log_softmax(logits)[action],
        value=estimate_value(weights, memory.hidden),
        reward=_reward(env, pose, success, rewards),
        done=success | (elapsed >= level.horizon),
        success=success,
        longest=level.longest,
        slot=env.slot,
        serial=env.serial,
    )
    visited = env.visited.at[pose.position].set(True)
    return env._replace(pose=pose, memory=memory, visited=visited, elapsed=elapsed), taken


def _reward(env: EnvState, pose: Pose, success: jax.Array, rewards: Rewards) -> jax.Array:
    """Reward the goal, the sooner the more, and first visits and progress as configured.

    With a haste of 0.9 the goal's part is that of MiniGrid, 1 - 0.9 t / T, positive to the end.
    """
    distance, here = env.level.distance, env.pose.position
    nearer = distance[here] - jnp.where(success, 0, distance[pose.position])
    new = ~env.visited[pose.position]
    goal = jnp.where(success, 1 - rewards.haste * (env.elapsed + 1) / env.level.horizon, 0.0)
    return goal + rewards.novelty * new + rewards.progress * nearer


def collect(
    key: jax.Array,
    weights: Weights,
    envs: EnvState,
    next_level: Callable[[jax.Array, jax.Array], tuple[Level, jax.Array, jax.Array]],
    timesteps: int,
    rewards: Rewards,
) -> tuple[EnvState, Transition, jax.Array]:
    """Let all environments act, each starting a new episode when one ends; consumes the key.

    Args:
        key: draws actions, levels and first headings.
        weights: the agent.
        envs: `EnvState` with a leading axis E.
        next_level: (number in [0, 1), environment) -> level, slot of the buffer, serial.
        timesteps: T.
        rewards: what is rewarded beside the goal.

    Returns:
        envs, steps with leading axes [T, E], value of the last states float32 [E].
    """
    count = envs.elapsed.shape[0]
    everyone = jax.vmap(lambda env, draw: _step_env(weights, env, draw, rewards))

    def restart(env: EnvState, done: jax.Array, draws: jax.Array, number: jax.Array) -> EnvState:
        heading = (4 * draws[1]).astype(jnp.int32)
        new = reset_env(weights, *next_level(draws[0], number), heading)
        return jax.tree.map(lambda a, b: jnp.where(done, a, b), new, env)

    def one(envs: EnvState, key: jax.Array) -> tuple[EnvState, Transition]:
        draws = jax.random.uniform(key, (count, 3))
        envs, steps = everyone(envs, draws[:, 0])
        # Levels are large and most steps end no episode: copy levels only when one does.
        envs = jax.lax.cond(
            steps.done.any(),
            lambda: jax.vmap(restart)(envs, steps.done, draws[:, 1:], jnp.arange(count)),
            lambda: envs,
        )
        return envs, steps

    envs, steps = jax.lax.scan(one, envs, jax.random.split(key, timesteps))
    # Learning needs the value of the states after the last step: one more step tells it.
    _, after = everyone(envs, jnp.zeros(count))
    return envs, steps, after.value


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
