"""One update of the agent's training: propose levels, play, learn."""

from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax

from qdenv.agent.curriculum import Bank, Method, admit, find_method, new_bank, replay_odds, rescore
from qdenv.agent.levels import Level, LevelConfig
from qdenv.agent.ppo import Batch, PPOConfig, advantages, learn
from qdenv.agent.rollout import Lane, RewardConfig, Step, begin, roll
from qdenv.simulate.maze.policy import Weights, draw_weights, load_weights
from qdenv.types import Array, InputError


@dataclass(frozen=True)
class TrainConfig:
    """One training run.

    Attributes:
        method: "dr" (domain randomisation), "plr" (robust PLR) or "accel".
        steps: environment steps to learn from, in all.
        seed: of everything.
        units: LSTM units of the agent.
        actions: 3 (turn left, turn right, forward) or 7 (the published set, 4 do nothing).
        warm_start: an .npz agent to start from; "" for fresh weights.
        bank: levels under replay.
        fresh: new levels per update.
        rate: first learning rate; falls linearly to a twentieth.
        entropy: first weight of the entropy bonus; falls linearly to a tenth.
        novelty_until: share of the training after which the novelty reward has faded to nothing;
            it begins to fade halfway there.
        exam: held-out mazes of each kind, played for every line of the log.
        ppo: numbers of the algorithm.
        reward: what is rewarded beside the goal.
        levels: what levels look like.
    """

    method: str = "dr"
    steps: int = 80_000_000
    seed: int = 0
    units: int = 64
    actions: int = 3
    warm_start: str = ""
    bank: int = 4096
    fresh: int = 64
    rate: float = 1e-3
    entropy: float = 5e-3
    novelty_until: float = 1.0
    exam: int = 32
    ppo: PPOConfig = field(default_factory=PPOConfig)
    reward: RewardConfig = field(default_factory=RewardConfig)
    levels: LevelConfig = field(default_factory=LevelConfig)

    @property
    def updates(self) -> int:
        """Count the updates of the whole run."""
        return -(-self.steps // (self.ppo.lanes * self.ppo.timesteps))


class State(NamedTuple):
    """Everything a training run carries from update to update."""

    weights: Weights
    optimiser: Any
    lanes: Lane
    bank: Bank
    key: Array  # raw key data, uint32 [2]
    update: Array  # int32


_new_bank = jax.jit(new_bank, static_argnums=(1, 2))


def _optimiser(config: TrainConfig) -> optax.GradientTransformation:
    """Adam with a clipped gradient; the rate is set from outside so that `steps` may change."""
    adam = optax.inject_hyperparams(optax.adam)(learning_rate=config.rate, eps=1e-5)
    return optax.chain(optax.clip_by_global_norm(1.0), adam)


def _check(config: TrainConfig) -> None:
    find_method(config.method)
    if config.actions < 3 or config.units < 1 or config.steps < 1:
        raise InputError("the agent needs at least 3 actions, 1 unit and 1 step")
    if config.ppo.lanes % config.ppo.minibatches:
        raise InputError("minibatches must divide lanes: each takes whole lanes")
    if not 0 < config.fresh <= config.bank:
        raise InputError("fresh levels per update must number between 1 and the bank's size")


def start(config: TrainConfig) -> State:
    """Draw the first state of a run.

    Raises:
        InputError: impossible numbers, or a warm start of another architecture.
    """
    _check(config)
    keys = jax.random.split(jax.random.key(config.seed), 5)
    weights = draw_weights(keys[0], config.units, config.actions)
    if config.warm_start:
        loaded = load_weights(config.warm_start)
        if any(a.shape != b.shape for a, b in zip(loaded, weights, strict=True)):
            raise InputError(f"{config.warm_start} has other units or actions than asked for")
        weights = Weights(*map(jnp.asarray, loaded))
    bank = _new_bank(keys[1], config.bank, config.levels)
    place = jax.random.randint(keys[2], (config.ppo.lanes,), 0, config.bank)
    heading = jax.random.randint(keys[3], (config.ppo.lanes,), 0, 4)
    level = jax.tree.map(lambda x: x[place], bank.level)
    lanes = jax.vmap(begin, (None, 0, 0, 0, 0))(weights, level, place, bank.serial[place], heading)
    optimiser = _optimiser(config).init(weights)
    return State(weights, optimiser, lanes, bank, jax.random.key_data(keys[4]), jnp.int32(0))


def _schedules(config: TrainConfig, update: Array) -> tuple[Array, Array, RewardConfig]:
    """Give the learning rate, the entropy weight and the rewards of an update."""
    done = jnp.minimum(update / config.updates, 1.0)
    novelty = config.reward.novelty
    if config.novelty_until < 1:
        fade = jnp.clip(2 - 2 * done / config.novelty_until, 0.0, 1.0)
        novelty = novelty * fade
    rate = config.rate * (1 - 0.95 * done)
    entropy = config.entropy * (1 - 0.9 * done)
    return rate, entropy, replace(config.reward, novelty=novelty)


def _try_out(
    key: Array, weights: Weights, levels: Level, config: TrainConfig, reward: RewardConfig
) -> Array:
    """Score new levels by one rollout without learning (float32 [fresh]); consumes the key."""
    keys = jax.random.split(key)
    number = jnp.arange(config.fresh)
    heading = jax.random.randint(keys[0], (config.fresh,), 0, 4)
    lanes = jax.vmap(begin, (None, 0, 0, 0, 0))(weights, levels, number, number, heading)

    def again(draw: Array, lane: Array) -> tuple[Level, Array, Array]:
        del draw
        return jax.tree.map(lambda x: x[lane], levels), lane, lane

    _, steps, last = roll(keys[1], weights, lanes, again, config.ppo.timesteps, reward)
    return jnp.maximum(advantages(steps, last, config.ppo), 0).mean(0)


def _renew(
    key: Array, state: State, config: TrainConfig, method: Method, reward: RewardConfig
) -> Bank:
    """Propose new levels, try them out if the method asks for it, let them in."""
    keys = jax.random.split(key)
    odds = replay_odds(state.bank, state.update, method)
    levels = jax.vmap(lambda key: method.propose(key, state.bank, odds, config.levels))(
        jax.random.split(keys[0], config.fresh)
    )
    score = jnp.zeros(config.fresh)
    if method.on_trial:
        score = _try_out(keys[1], state.weights, levels, config, reward)
    return admit(state.bank, levels, score, state.update, method)


def _numbers(steps: Step, log: Array, bank: Bank) -> dict[str, Array]:
    """Sum an update up for the log."""
    ended, longest = steps.done.sum(), (steps.done & steps.longest).sum()
    return {
        "success": steps.success.sum() / jnp.maximum(ended, 1),
        "success_longest": (steps.success & steps.longest).sum() / jnp.maximum(longest, 1),
        "entropy": log[0],
        "divergence": log[1],
        "value_error": log[2],
        "bank_score": bank.score.mean(),
    }


def update(state: State, config: TrainConfig) -> tuple[State, dict[str, Array]]:
    """Renew the bank, play its levels, learn; traceable.

    Returns:
        the new state, and numbers for the log.
    """
    method = find_method(config.method)
    keys = jax.random.split(jax.random.wrap_key_data(state.key), 4)
    rate, entropy, reward = _schedules(config, state.update)
    bank = _renew(keys[0], state, config, method, reward)
    ladder = jnp.cumsum(replay_odds(bank, state.update, method))

    def next_level(draw: Array, lane: Array) -> tuple[Level, Array, Array]:
        del lane
        place = jnp.searchsorted(ladder, draw * ladder[-1], side="right")
        place = jnp.minimum(place, config.bank - 1)
        return jax.tree.map(lambda x: x[place], bank.level), place, bank.serial[place]

    lanes, steps, last = roll(
        keys[1], state.weights, state.lanes, next_level, config.ppo.timesteps, reward
    )
    gain = advantages(steps, last, config.ppo)
    if method.on_trial:
        bank = rescore(bank, state.update, steps.index, steps.serial, gain)
    optimiser = state.optimiser
    optimiser[1].hyperparams["learning_rate"] = rate
    batch = Batch(steps, state.lanes.memory, gain, gain + steps.value)
    weights, optimiser, log = learn(
        keys[2], state.weights, _optimiser(config), optimiser, batch, config.ppo, entropy
    )
    key = jax.random.key_data(keys[3])
    new = State(weights, optimiser, lanes, bank, key, state.update + 1)
    return new, _numbers(steps, log, bank)
