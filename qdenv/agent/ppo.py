"""Proximal policy optimisation of the recurrent maze agent (Schulman et al. 2017)."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import optax

from qdenv.agent.levels import Level
from qdenv.simulate.maze import Pose, choose, image, step, view
from qdenv.simulate.policy import Memory, Weights, act, assess, blank_memory, encode, recur
from qdenv.types import Array


class PPOConfig(NamedTuple):
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


class RewardConfig(NamedTuple):
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


class Batch(NamedTuple):
    """A rollout ready for learning; leading axes [T, lanes] but for the memory."""

    steps: Step
    memory: Memory  # before the first step, [lanes, L]
    gain: Array  # float32, advantages
    target: Array  # float32, returns


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
    next_level: Callable[[Array], tuple[Level, Array, Array]],
    timesteps: int,
    reward: RewardConfig,
) -> tuple[Lane, Step, Array]:
    """Let all lanes act, each starting a new episode when one ends; consumes the key.

    Args:
        key: draws actions, levels and first headings.
        weights: the agent.
        lanes: `Lane` with a leading axis.
        next_level: (key, lane number) -> level, place in the bank, serial; consumes its key.
        timesteps: T.
        reward: what is rewarded.

    Returns:
        lanes, steps with leading axes [T, lanes], value of the last states float32 [lanes].
    """
    count = lanes.elapsed.shape[0]

    def restart(lane: Lane, done: Array, key: Array, number: Array) -> Lane:
        level_key, turn_key = jax.random.split(key)
        heading = jax.random.randint(turn_key, (), 0, 4)
        new = begin(weights, *next_level(level_key, number), heading)
        return jax.tree.map(lambda a, b: jnp.where(done, a, b), new, lane)

    def one(lanes: Lane, key: Array) -> tuple[Lane, Step]:
        draw_key, restart_key = jax.random.split(key)
        draws = jax.random.uniform(draw_key, (count,))
        lanes, steps = jax.vmap(advance, (None, 0, 0, None))(weights, lanes, draws, reward)
        keys = jax.random.split(restart_key, count)
        return jax.vmap(restart)(lanes, steps.done, keys, jnp.arange(count)), steps

    lanes, steps = jax.lax.scan(one, lanes, jax.random.split(key, timesteps))
    _, after = jax.vmap(advance, (None, 0, 0, None))(weights, lanes, jnp.zeros(count), reward)
    return lanes, steps, after.value


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
