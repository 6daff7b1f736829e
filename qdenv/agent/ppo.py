"""PPO with a recurrent network: play levels side by side, estimate advantages, learn."""

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import chex
import jax
import jax.numpy as jnp
import optax

from qdenv.agent.levels import Level
from qdenv.agent.settings import PPOConfig
from qdenv.simulation.maze import policy
from qdenv.simulation.maze.episode import choose
from qdenv.simulation.maze.policy import Memory, Weights
from qdenv.simulation.maze.world import Pose, image, step, view

_Learner: TypeAlias = tuple[Weights, optax.OptState]
# The numbers of `RewardConfig` at one moment of the training: novelty, progress, haste.
Rewards: TypeAlias = tuple[jax.Array | float, float, float]


class EnvState(NamedTuple):
    """One environment under way."""

    level: Level
    slot: jax.Array  # int32, the level's place in the buffer
    serial: jax.Array  # int32, the level's number: does the buffer still hold it?
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
    visited = jnp.zeros(level.distance.shape, bool).at[level.start].set(True)
    pose, memory = Pose(level.start, heading), policy.blank_memory(weights)
    return EnvState(level, slot, serial, pose, memory, visited, jnp.int32(0))


def _step_env(
    weights: Weights, env: EnvState, draw: jax.Array, rewards: Rewards
) -> tuple[EnvState, Transition]:
    """Act once, by a draw in [0, 1), without starting over when the episode ends."""
    level, heading = env.level, jnp.asarray(env.pose.heading)
    seen = view(level.kinds, env.pose.position, heading)
    facing = jax.nn.one_hot(heading, 4)
    memory = policy.recur(weights, policy.encode(weights, image(seen), facing), env.memory)
    logits = policy.act(weights, memory.hidden)
    action = choose(logits, draw)
    pose, success = step(level.kinds, env.pose, action)
    elapsed = env.elapsed + 1
    taken = Transition(
        view=seen,
        heading=heading,
        fresh=env.elapsed == 0,
        action=action,
        log_prob=jax.nn.log_softmax(logits)[action],
        value=policy.estimate_value(weights, memory.hidden),
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
    """Reward the goal, the sooner the more, and first visits and progress as configured."""
    novelty, progress, haste = rewards
    # With a haste of 0.9 the goal's part is that of MiniGrid, 1 - 0.9 t / T, positive to the end.
    distance, here = env.level.distance, env.pose.position
    nearer = distance[here] - jnp.where(success, 0, distance[pose.position])
    new = ~env.visited[pose.position]
    goal = jnp.where(success, 1 - haste * (env.elapsed + 1) / env.level.horizon, 0.0)
    return goal + novelty * new + progress * nearer


def collect(
    key: jax.Array,
    weights: Weights,
    envs: EnvState,
    next_level: Callable[[jax.Array, jax.Array], tuple[Level, jax.Array, jax.Array]],
    timesteps: int,
    rewards: Rewards,
) -> tuple[EnvState, Transition, jax.Array]:
    """Let E environments act for T timesteps, each starting again when an episode ends.

    `next_level` gives (number in [0, 1), environment) -> level, slot of the buffer, serial number.
    Returns the environments, their steps [T, E], and the value of the last states float32 [E].
    Consumes the key, which draws actions, levels and first headings.
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
    # Learning needs the value of the states after the last step: one more step gives it.
    _, after = everyone(envs, jnp.zeros(count))
    return envs, steps, after.value


class Batch(NamedTuple):
    """A rollout ready for learning; leading axes [T, E] but for the memory."""

    steps: Transition
    memory: Memory  # before the first step, [E, L]
    advantage: jax.Array  # float32
    returns: jax.Array  # float32, targets of the value
    anchored: jax.Array  # float32 [T, E, N], log probabilities of the anchor; N is 0 without one


def advantages(steps: Transition, last_value: jax.Array, config: PPOConfig) -> jax.Array:
    """Estimate the advantages of steps [T, E], backwards in time (float32 [T, E]).

    Generalized advantage estimation, Schulman et al. 2016, https://arxiv.org/abs/1506.02438.
    """
    chex.assert_shape(last_value, steps.reward.shape[1:])

    def back(
        carry: tuple[jax.Array, jax.Array], now: Transition
    ) -> tuple[tuple[jax.Array, jax.Array], jax.Array]:
        next_advantage, next_value = carry
        alive = 1.0 - now.done
        td_error = now.reward + config.discount * alive * next_value - now.value
        advantage = td_error + config.discount * config.trace * alive * next_advantage
        return (advantage, now.value), advantage

    return jax.lax.scan(back, (jnp.zeros_like(last_value), last_value), steps, reverse=True)[1]


def unroll(weights: Weights, steps: Transition, memory: Memory) -> tuple[Memory, jax.Array]:
    """Run the network over recorded steps [T, E] -> last memory, hidden states [T, E, L]."""
    # All observations are known: only the recurrence itself has to wait for the step before.
    gates = policy.encode(weights, image(steps.view), jax.nn.one_hot(steps.heading, 4))

    def one(memory: Memory, now: tuple[jax.Array, jax.Array]) -> tuple[Memory, jax.Array]:
        gates, fresh = now
        keep = 1.0 - fresh[:, None]
        memory = policy.recur(weights, gates, Memory(memory.hidden * keep, memory.cell * keep))
        return memory, jnp.asarray(memory.hidden)

    return jax.lax.scan(one, memory, (gates, steps.fresh))


def _loss(
    weights: Weights, batch: Batch, config: PPOConfig, entropy: jax.Array, anchor: float
) -> tuple[jax.Array, dict[str, jax.Array]]:
    """Compute the clipped surrogate loss of PPO (https://arxiv.org/abs/1707.06347), and a log."""
    _, hidden = unroll(weights, batch.steps, batch.memory)
    log_probs = jax.nn.log_softmax(policy.act(weights, hidden))
    taken = jnp.take_along_axis(log_probs, batch.steps.action[..., None], -1)[..., 0]
    log_ratio = taken - batch.steps.log_prob
    ratio = jnp.exp(log_ratio)
    clipped = jnp.clip(ratio, 1 - config.clip, 1 + config.clip)
    # The smaller of both: an action may lose its advantage without bound but gain only so much.
    surrogate = -jnp.minimum(ratio * batch.advantage, clipped * batch.advantage).mean()
    value_error = jnp.square(policy.estimate_value(weights, hidden) - batch.returns).mean()
    policy_entropy = -(jnp.exp(log_probs) * log_probs).sum(-1).mean()
    total = surrogate + config.critic * value_error - entropy * policy_entropy
    if anchor:
        known = batch.anchored
        total += anchor * (jnp.exp(known) * (known - log_probs)).sum(-1).mean()
    # (r - 1) - log r is never negative and has the divergence from the old policy as its mean.
    divergence = ((ratio - 1) - log_ratio).mean()
    return total, {"entropy": policy_entropy, "divergence": divergence, "value_error": value_error}


def learn(
    key: jax.Array,
    weights: Weights,
    optimiser: optax.GradientTransformation,
    state: optax.OptState,
    batch: Batch,
    config: PPOConfig,
    entropy: jax.Array,
    anchor: float = 0.0,
) -> tuple[Weights, optax.OptState, dict[str, jax.Array]]:
    """Improve the weights on one rollout; consumes the key.

    Returns the weights, the optimiser's state, and for the log the means over the minibatches of
    the policy's entropy (nats), its divergence from the old one and the value's squared error.
    """
    advantage = (batch.advantage - batch.advantage.mean()) / (batch.advantage.std() + 1e-8)
    batch = batch._replace(advantage=advantage)

    def one(carry: _Learner, envs: jax.Array) -> tuple[_Learner, dict[str, jax.Array]]:
        weights, state = carry
        memory = jax.tree.map(lambda x: x[envs], batch.memory)
        columns = batch.steps, batch.advantage, batch.returns, batch.anchored
        steps, *others = jax.tree.map(lambda x: x[:, envs], columns)
        part = Batch(steps, memory, *others)
        grads, log = jax.grad(_loss, has_aux=True)(weights, part, config, entropy, anchor)
        updates, state = optimiser.update(grads, state, weights)
        return (optax.apply_updates(weights, updates), state), log

    # Minibatches of whole environments: the recurrent state must run through every rollout.
    keys = jax.random.split(key, config.epochs)
    order = jax.vmap(lambda k: jax.random.permutation(k, config.lanes))(keys)
    order = order.reshape(config.epochs * config.minibatches, -1)
    (weights, state), log = jax.lax.scan(one, (weights, state), order)
    return weights, state, jax.tree.map(lambda numbers: numbers.mean(0), log)
