"""One update of the agent's training: propose levels, play, learn."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import optax

from qdenv.agent import levels
from qdenv.agent.ppo import Batch, EnvState, Rewards, advantages, collect, learn, reset_env, unroll
from qdenv.agent.settings import TrainConfig
from qdenv.simulate.maze import policy
from qdenv.types import InputError, look_up


class Anchor(NamedTuple):
    """The policy to stay near, and its own memory of what the environments have seen."""

    weights: policy.Weights
    memory: policy.Memory  # [E, L]


class State(NamedTuple):
    """Everything a training run carries from update to update."""

    weights: policy.Weights
    optimiser: optax.OptState
    envs: EnvState  # leading axis E
    buffer: levels.LevelBuffer
    key: jax.Array  # raw key data, uint32 [2]
    update: jax.Array  # int32
    anchor: Anchor | None = None


_new_buffer = jax.jit(levels.new_buffer, static_argnums=(1, 2))
_reset_all = jax.vmap(reset_env, (None, 0, 0, 0, 0))


def _optimiser(config: TrainConfig) -> optax.GradientTransformation:
    """Adam with a clipped gradient; the rate is set from outside so that `steps` may change."""
    adam = optax.inject_hyperparams(optax.adam)(learning_rate=config.rate, eps=1e-5)
    return optax.chain(optax.clip_by_global_norm(1.0), adam)


def start(config: TrainConfig) -> State:
    """Draw the first state of a run; InputError if a warm start has other sizes."""
    keys = jax.random.split(jax.random.key(config.seed), 5)
    weights = policy.draw_weights(keys[0], config.units, config.actions)
    if config.warm_start:
        loaded = policy.load_weights(config.warm_start)
        if any(a.shape != b.shape for a, b in zip(loaded, weights, strict=True)):
            raise InputError(f"{config.warm_start} has other units or actions than asked for")
        weights = policy.Weights(*map(jnp.asarray, loaded))
    buffer, lanes = _new_buffer(keys[1], config.bank, config.levels), config.ppo.lanes
    slot = jax.random.randint(keys[2], (lanes,), 0, config.bank)
    heading = jax.random.randint(keys[3], (lanes,), 0, 4)
    level = jax.tree.map(lambda x: x[slot], buffer.level)
    envs = _reset_all(weights, level, slot, buffer.serial[slot], heading)
    anchor = Anchor(weights, policy.blank_memory(weights, (lanes,))) if config.anchor else None
    optimiser, key = _optimiser(config).init(weights), jax.random.key_data(keys[4])
    return State(weights, optimiser, envs, buffer, key, jnp.int32(0), anchor)


def _renew(
    key: jax.Array, state: State, config: TrainConfig, method: levels.Method, rewards: Rewards
) -> levels.LevelBuffer:
    """Propose new levels and let them in, after a trial without learning if the method has one."""
    keys, fresh = jax.random.split(key), config.fresh
    probabilities = levels.replay_probabilities(state.buffer, state.update, method)
    proposed = jax.vmap(
        lambda key: method.propose(key, state.buffer, probabilities, config.levels)
    )(jax.random.split(keys[0], fresh))
    score = jnp.zeros(fresh)
    if method.on_trial:

        def same_level(
            draw: jax.Array, env: jax.Array
        ) -> tuple[levels.Level, jax.Array, jax.Array]:
            del draw
            return jax.tree.map(lambda x: x[env], proposed), env, env

        trial, number = jax.random.split(keys[1]), jnp.arange(fresh)
        heading = jax.random.randint(trial[0], (fresh,), 0, 4)
        envs = _reset_all(state.weights, proposed, number, number, heading)
        _, steps, last_value = collect(
            trial[1], state.weights, envs, same_level, config.ppo.timesteps, rewards
        )
        score = jnp.maximum(advantages(steps, last_value, config.ppo), 0).mean(0)
    return levels.insert(state.buffer, proposed, score, state.update, method)


def update(state: State, config: TrainConfig) -> tuple[State, dict[str, jax.Array]]:
    """Renew the buffer, play its levels, learn; traceable. Returns also numbers for the log."""
    method = look_up(levels.METHODS, config.method, "method")
    keys = jax.random.split(jax.random.wrap_key_data(state.key), 4)
    done = jnp.minimum(state.update / config.updates, 1.0)  # share of the training
    novelty: jax.Array | float = config.reward.novelty
    if config.novelty_until < 1:
        novelty = novelty * jnp.clip(2 - 2 * done / config.novelty_until, 0.0, 1.0)
    rewards = Rewards(novelty, config.reward.progress, config.reward.haste)
    buffer = _renew(keys[0], state, config, method, rewards)
    probabilities = levels.replay_probabilities(buffer, state.update, method)
    cumulative = jnp.cumsum(probabilities)

    def next_level(draw: jax.Array, env: jax.Array) -> tuple[levels.Level, jax.Array, jax.Array]:
        del env
        # Inverse transform sampling; the sum may miss 1 by a rounding, the slot the last level.
        slot = jnp.searchsorted(cumulative, draw * cumulative[-1], side="right")
        slot = jnp.minimum(slot, probabilities.size - 1)
        return jax.tree.map(lambda x: x[slot], buffer.level), slot, buffer.serial[slot]

    envs, steps, last_value = collect(
        keys[1], state.weights, state.envs, next_level, config.ppo.timesteps, rewards
    )
    advantage = advantages(steps, last_value, config.ppo)
    if method.on_trial:
        buffer = levels.update_scores(buffer, state.update, steps.slot, steps.serial, advantage)
    # What the anchor would have done at every step, as log probabilities [T, E, N].
    anchor, anchored = state.anchor, jnp.zeros((*steps.action.shape, 0))
    if anchor is not None:
        memory, hidden = unroll(anchor.weights, steps, anchor.memory)
        anchored = jax.nn.log_softmax(policy.act(anchor.weights, hidden))
        anchor = anchor._replace(memory=memory)
    batch = Batch(steps, state.envs.memory, advantage, advantage + steps.value, anchored)
    clipping, adam = state.optimiser
    rate, entropy = config.rate * (1 - 0.95 * done), config.entropy * (1 - 0.9 * done)
    adam = adam._replace(hyperparams={**adam.hyperparams, "learning_rate": rate})
    weights, optimiser, log = learn(
        keys[2],
        state.weights,
        _optimiser(config),
        (clipping, adam),
        batch,
        config.ppo,
        entropy,
        config.anchor,
    )
    key, ended = jax.random.key_data(keys[3]), steps.done.sum()
    longest = (steps.done & steps.longest).sum()
    log |= {
        "success": steps.success.sum() / jnp.maximum(ended, 1),
        "success_longest": (steps.success & steps.longest).sum() / jnp.maximum(longest, 1),
        "bank_score": buffer.score.mean(),
    }
    return State(weights, optimiser, envs, buffer, key, state.update + 1, anchor), log
