"""Let the agent play training levels side by side and record what it did."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdenv.agent.levels import Level
from qdenv.simulate.maze.episode import choose
from qdenv.simulate.maze.policy import Memory, Weights, act, assess, blank_memory, encode, recur
from qdenv.simulate.maze.world import Pose, image, step, view
from qdenv.types import Array


@dataclass(frozen=True)
class RewardConfig:
    """What is rewarded beside the goal.

    Attributes:
        novelty: the first visit of a tile in an episode.
        progress: each move nearer to the goal (potential-based).
    """

    novelty: float = 0.01
    progress: float = 0.0


class Lane(NamedTuple):
    """One environment under way."""

    level: Level
    index: Array  # int32, the level's place in the bank
    serial: Array  # int32, tells whether the bank still holds this level
    pose: Pose
    memory: Memory
    visited: Array  # bool, tiles trodden in this episode
    elapsed: Array  # int32, actions taken


class Step(NamedTuple):
    """What one step leaves behind for learning."""

    view: Array  # int8 [5, 5]
    heading: Array  # int32
    fresh: Array  # bool, the memory was blank before this step
    action: Array  # int32
    log_prob: Array  # float32
    value: Array  # float32
    reward: Array  # float32
    done: Array  # bool, the episode ended with this step
    success: Array  # bool, at the goal
    longest: Array  # bool, on a longest-path pair
    index: Array  # int32, the level's place in the bank
    serial: Array  # int32, the level's number


def begin(weights: Weights, level: Level, index: Array, serial: Array, heading: Array) -> Lane:
    """Put the agent at the start of a level."""
    return Lane(
        level=level,
        index=index,
        serial=serial,
        pose=Pose(level.start, heading),
        memory=blank_memory(weights),
        visited=jnp.zeros(level.distance.shape, bool).at[level.start].set(True),
        elapsed=jnp.int32(0),
    )


def advance(weights: Weights, lane: Lane, draw: Array, reward: RewardConfig) -> tuple[Lane, Step]:
    """Act once in one lane, without starting over when the episode ends.

    Args:
        weights: the agent.
        lane: the environment.
        draw: float32 in [0, 1), decides the action.
        reward: what is rewarded.
    """
    level, here = lane.level, lane.pose.position
    seen = view(level.kinds, here, lane.pose.heading)
    facing = jax.nn.one_hot(lane.pose.heading, 4)
    memory = recur(weights, encode(weights, image(seen), facing), lane.memory)
    logits = act(weights, memory.hidden)
    action = choose(logits, draw)
    pose, success = step(level.kinds, lane.pose, action)
    elapsed = lane.elapsed + 1
    left = Step(
        view=seen,
        heading=lane.pose.heading,
        fresh=lane.elapsed == 0,
        action=action,
        log_prob=jax.nn.log_softmax(logits)[action],
        value=assess(weights, memory.hidden),
        reward=_reward(lane, pose, success, reward),
        done=success | (elapsed >= level.horizon),
        success=success,
        longest=level.longest,
        index=lane.index,
        serial=lane.serial,
    )
    visited = lane.visited.at[pose.position].set(True)
    return lane._replace(pose=pose, memory=memory, visited=visited, elapsed=elapsed), left


def _reward(lane: Lane, pose: Pose, success: Array, config: RewardConfig) -> jax.Array:
    """Reward the goal, the sooner the more, and first visits and progress as configured."""
    distance, here = lane.level.distance, lane.pose.position
    nearer = distance[here] - jnp.where(success, 0, distance[pose.position])
    new = ~lane.visited[pose.position]
    goal = jnp.where(success, 1 - 0.9 * (lane.elapsed + 1) / lane.level.horizon, 0.0)
    return goal + config.novelty * new + config.progress * nearer


def roll(
    key: Array,
    weights: Weights,
    lanes: Lane,
    next_level: Callable[[Array, Array], tuple[Level, Array, Array]],
    timesteps: int,
    reward: RewardConfig,
) -> tuple[Lane, Step, Array]:
    """Let all lanes act, each starting a new episode when one ends; consumes the key.

    Args:
        key: draws actions, levels and first headings.
        weights: the agent.
        lanes: `Lane` with a leading axis.
        next_level: (number in [0, 1), lane) -> level, place in the bank, serial.
        timesteps: T.
        reward: what is rewarded.

    Returns:
        lanes, steps with leading axes [T, lanes], value of the last states float32 [lanes].
    """
    count = lanes.elapsed.shape[0]
    everywhere = jax.vmap(lambda lane, draw: advance(weights, lane, draw, reward))

    def restart(lane: Lane, done: Array, draws: Array, number: Array) -> Lane:
        heading = (4 * draws[1]).astype(jnp.int32)
        new = begin(weights, *next_level(draws[0], number), heading)
        return jax.tree.map(lambda a, b: jnp.where(done, a, b), new, lane)

    def one(lanes: Lane, key: Array) -> tuple[Lane, Step]:
        draws = jax.random.uniform(key, (count, 3))
        lanes, steps = everywhere(lanes, draws[:, 0])
        return jax.vmap(restart)(lanes, steps.done, draws[:, 1:], jnp.arange(count)), steps

    lanes, steps = jax.lax.scan(one, lanes, jax.random.split(key, timesteps))
    _, after = everywhere(lanes, jnp.zeros(count))
    return lanes, steps, after.value
