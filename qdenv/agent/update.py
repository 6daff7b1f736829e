"""One update of the agent's training: propose levels, play, learn."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import optax

from qdenv.agent.levels import (
    METHODS,
    Level,
    LevelBuffer,
    Method,
    insert,
    new_buffer,
    replay_probabilities,
    update_scores,
)
from qdenv.agent.ppo import (
    Batch,
    EnvState,
    LearningLog,
    Rewards,
    Transition,
    advantages,
    collect,
    learn,
    reset_env,
    unroll,
)
from qdenv.agent.settings import TrainConfig
from qdenv.simulate.maze.policy import (
    Memory,
    Weights,
    act,
    blank_memory,
    draw_weights,
    load_weights,
)
from qdenv.types import InputError, look_up


class Anchor(NamedTuple):
    """The policy to stay near, and its own memory of what the environments have seen."""

    weights: Weights
    memory: Memory  # [E, L]


class State(NamedTuple):
    """Everything a training run carries from update to update."""

    weights: Weights
    optimiser: optax.OptState
    envs: EnvState  # leading axis E
    buffer: LevelBuffer
    key: jax.Array  # raw key data, uint32 [2]
    update: jax.Array  # int32
    anchor: Anchor | None = None


_new_buffer = jax.jit(new_buffer, static_argnums=(1, 2))


def _optimiser(config: TrainConfig) -> optax.GradientTransformation:
    """Adam with a clipped gradient; the rate is set from outside so that `steps` may change."""
    adam = optax.inject_hyperparams(optax.adam)(learning_rate=config.rate, eps=1e-5)
    return optax.chain(optax.clip_by_global_norm(1.0), adam)


def _with_rate(state: optax.OptState, rate: jax.Array) -> optax.OptState:
    """Give the state of `_optimiser` another learning rate."""
    clipping, adam = state
    return clipping, adam._replace(hyperparams={**adam.hyperparams, "learning_rate": rate})


def start(config: TrainConfig) -> State:
    """Draw the first state of a run.

    Raises:
        InputError: impossible numbers, or a warm start of another architecture.
    """
    keys = jax.random.split(jax.random.key(config.seed), 5)
    weights = draw_weights(keys[0], config.units, config.actions)
    if config.warm_start:
        loaded = load_weights(config.warm_start)
        if any(a.shape != b.shape for a, b in zip(loaded, weights, strict=True)):
            raise InputError(f"{config.warm_start} has other units or actions than asked for")
        weights = Weights(*map(jnp.asarray, loaded))
    buffer = _new_buffer(keys[1], config.bank, config.levels)
    slot = jax.random.randint(keys[2], (config.ppo.lanes,), 0, config.bank)
    heading = jax.random.randint(keys[3], (config.ppo.lanes,), 0, 4)
    level = jax.tree.map(lambda x: x[slot], buffer.level)
    reset = jax.vmap(reset_env, (None, 0, 0, 0, 0))
    envs = reset(weights, level, slot, buffer.serial[slot], heading)
    optimiser = _optimiser(config).init(weights)
    anchor = Anchor(weights, blank_memory(weights, (config.ppo.lanes,))) if config.anchor else None
    key = jax.random.key_data(keys[4])
    return State(weights, optimiser, envs, buffer, key, jnp.int32(0), anchor)


class _Schedule(NamedTuple):
    """What changes in the course of the training."""

    learning_rate: jax.Array
    entropy: jax.Array  # weight of the entropy bonus
    rewards: Rewards


def _schedule(config: TrainConfig, update: jax.Array) -> _Schedule:
    done = jnp.minimum(update / config.updates, 1.0)
    novelty: jax.Array | float = config.reward.novelty
    if config.novelty_until < 1:
        novelty = novelty * jnp.clip(2 - 2 * done / config.novelty_until, 0.0, 1.0)
    rewards = Rewards(novelty, config.reward.progress, config.reward.haste)
    return _Schedule(config.rate * (1 - 0.95 * done), config.entropy * (1 - 0.9 * done), rewards)


def _score_unseen(
    key: jax.Array, weights: Weights, levels: Level, config: TrainConfig, rewards: Rewards
) -> jax.Array:
    """Score new levels by one rollout without learning (float32 [fresh]); consumes the key."""
    keys = jax.random.split(key)
    number = jnp.arange(config.fresh)
    heading = jax.random.randint(keys[0], (config.fresh,), 0, 4)
    reset = jax.vmap(reset_env, (None, 0, 0, 0, 0))
    envs = reset(weights, levels, number, number, heading)

    def same_level(draw: jax.Array, env: jax.Array) -> tuple[Level, jax.Array, jax.Array]:
        del draw
        return jax.tree.map(lambda x: x[env], levels), env, env

    _, steps, last_value = collect(
        keys[1], weights, envs, same_level, config.ppo.timesteps, rewards
    )
    return jnp.maximum(advantages(steps, last_value, config.ppo), 0).mean(0)


def _renew(
    key: jax.Array, state: State, config: TrainConfig, method: Method, rewards: Rewards
) -> LevelBuffer:
    """Propose new levels, try them out if the method asks for it, let them in."""
    keys = jax.random.split(key)
    probabilities = replay_probabilities(state.buffer, state.update, method)
    levels = jax.vmap(lambda key: method.propose(key, state.buffer, probabilities, config.levels))(
        jax.random.split(keys[0], config.fresh)
    )
    score = jnp.zeros(config.fresh)
    if method.on_trial:
        score = _score_unseen(keys[1], state.weights, levels, config, rewards)
    return insert(state.buffer, levels, score, state.update, method)


def _replayed(
    buffer: LevelBuffer, probabilities: jax.Array
) -> Callable[[jax.Array, jax.Array], tuple[Level, jax.Array, jax.Array]]:
    """Make the function that draws the next level of an environment from the buffer."""
    cumulative = jnp.cumsum(probabilities)

    def next_level(draw: jax.Array, env: jax.Array) -> tuple[Level, jax.Array, jax.Array]:
        del env
        # Inverse transform sampling; the sum may miss 1 by a rounding, the slot the last level.
        slot = jnp.searchsorted(cumulative, draw * cumulative[-1], side="right")
        slot = jnp.minimum(slot, probabilities.size - 1)
        return jax.tree.map(lambda x: x[slot], buffer.level), slot, buffer.serial[slot]

    return next_level


def _metrics(steps: Transition, log: LearningLog, buffer: LevelBuffer) -> dict[str, jax.Array]:
    """Sum an update up for the log."""
    ended, longest = steps.done.sum(), (steps.done & steps.longest).sum()
    return {
        "success": steps.success.sum() / jnp.maximum(ended, 1),
        "success_longest": (steps.success & steps.longest).sum() / jnp.maximum(longest, 1),
        "entropy": log.policy_entropy,
        "divergence": log.approx_kl,
        "value_error": log.value_loss,
        "bank_score": buffer.score.mean(),
    }


def _recall(anchor: Anchor | None, steps: Transition) -> tuple[Anchor | None, jax.Array]:
    """Ask the anchor what it would have done at every step -> log probabilities [T, E, N]."""
    if anchor is None:
        return None, jnp.zeros((*steps.action.shape, 0))
    memory, hidden = unroll(anchor.weights, steps, anchor.memory)
    return anchor._replace(memory=memory), jax.nn.log_softmax(act(anchor.weights, hidden))


def update(state: State, config: TrainConfig) -> tuple[State, dict[str, jax.Array]]:
    """Renew the buffer, play its levels, learn; traceable.

    Returns:
        the new state, and numbers for the log.
    """
    method = look_up(METHODS, config.method, "method")
    keys = jax.random.split(jax.random.wrap_key_data(state.key), 4)
    now = _schedule(config, state.update)
    buffer = _renew(keys[0], state, config, method, now.rewards)
    next_level = _replayed(buffer, replay_probabilities(buffer, state.update, method))
    envs, steps, last_value = collect(
        keys[1], state.weights, state.envs, next_level, config.ppo.timesteps, now.rewards
    )
    advantage = advantages(steps, last_value, config.ppo)
    if method.on_trial:
        buffer = update_scores(buffer, state.update, steps.slot, steps.serial, advantage)
    anchor, anchored = _recall(state.anchor, steps)
    returns = advantage + steps.value
    batch = Batch(steps, state.envs.memory, advantage, returns, anchored)
    optimiser = _with_rate(state.optimiser, now.learning_rate)
    weights, optimiser, log = learn(
        keys[2],
        state.weights,
        _optimiser(config),
        optimiser,
        batch,
        config.ppo,
        now.entropy,
        config.anchor,
    )
    key = jax.random.key_data(keys[3])
    new = State(weights, optimiser, envs, buffer, key, state.update + 1, anchor)
    return new, _metrics(steps, log, buffer)
