"""Let the agent play training levels side by side and record what it did."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdenv.agent.levels import Level
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


def step_env(
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
    everyone = jax.vmap(lambda env, draw: step_env(weights, env, draw, rewards))

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
