"""Which levels the agent trains on: domain randomisation, robust PLR, ACCEL.

A bank of levels is replayed; a method says how new levels come about and whether they must first
prove worth training on. The worth of a level is its mean positive advantage, "positive value loss"
(Jiang et al. 2021, Replay-Guided Adversarial Environment Design; Parker-Holder et al. 2022).
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdenv.agent.levels import Level, LevelConfig, draw_level, vary_level
from qdenv.types import Array, look_up


class Bank(NamedTuple):
    """The levels under replay, each with a leading axis [C]."""

    level: Level
    score: Array  # float32, mean positive advantage when last seen
    seen: Array  # int32, update at which it was last scored
    serial: Array  # int32, number of the level since the beginning


class Method(NamedTuple):
    """How the bank is renewed.

    Attributes:
        propose: (key, bank, odds [C], config) -> one new level; consumes the key.
        on_trial: new levels are tried without learning and admitted by score (robust PLR); else
            each replaces the oldest level, and all levels are replayed alike.
    """

    propose: Callable[[Array, Bank, Array, LevelConfig], Level]
    on_trial: bool


def _draw(key: Array, bank: Bank, odds: Array, config: LevelConfig) -> Level:
    del bank, odds
    return draw_level(key, config)


def _draw_or_vary(key: Array, bank: Bank, odds: Array, config: LevelConfig) -> Level:
    """Edit a level that is worth replaying, or draw a new one, with even odds."""
    keys = jax.random.split(key, 4)
    parent = jax.random.choice(keys[0], odds.shape[0], p=odds)
    edited = vary_level(keys[1], jax.tree.map(lambda x: x[parent], bank.level), config)
    new = draw_level(keys[2], config)
    return jax.tree.map(lambda a, b: jnp.where(jax.random.bernoulli(keys[3]), a, b), edited, new)


METHODS = {
    "dr": Method(_draw, on_trial=False),
    "plr": Method(_draw, on_trial=True),
    "accel": Method(_draw_or_vary, on_trial=True),
}


def find_method(name: str) -> Method:
    """Look a method up by name.

    Raises:
        InputError: no method has this name.
    """
    return look_up(METHODS, name, "method")


def new_bank(key: Array, size: int, config: LevelConfig) -> Bank:
    """Fill a bank with drawn levels, a few at a time; consumes the key."""
    level = jax.lax.map(
        lambda k: draw_level(k, config), jax.random.split(key, size), batch_size=min(size, 64)
    )
    zeros = jnp.zeros(size, jnp.int32)
    return Bank(level, jnp.zeros(size), zeros, jnp.arange(size, dtype=jnp.int32))


def replay_odds(bank: Bank, update: Array, method: Method, staleness: float = 0.3) -> jax.Array:
    """Weigh the levels for replay: evenly, or by score with a share for those long unseen.

    Returns:
        float32 [C], sums to 1.
    """
    if not method.on_trial:
        return jnp.full(bank.score.shape, 1 / bank.score.size)
    by_score = (bank.score + 1e-6) / (bank.score + 1e-6).sum()
    age = (update - bank.seen + 1).astype(jnp.float32)
    return (1 - staleness) * by_score + staleness * age / age.sum()


def rescore(bank: Bank, update: Array, index: Array, serial: Array, gain: Array) -> Bank:
    """Note the scores of the levels that were just played.

    Args:
        bank: the bank.
        update: number of this update.
        index: int32 [...], place of the level played at each step.
        serial: int32 [...], its number; steps of levels that have left the bank are ignored.
        gain: float32 [...], advantages.
    """
    size = bank.score.size
    place = jnp.where(bank.serial[index] == serial, index, size).reshape(-1)
    worth = jnp.maximum(gain, 0).reshape(-1)
    total = jnp.zeros(size).at[place].add(worth, mode="drop")
    count = jnp.zeros(size).at[place].add(1.0, mode="drop")
    played = count > 0
    score = jnp.where(played, total / jnp.maximum(count, 1), bank.score)
    return bank._replace(score=score, seen=jnp.where(played, update, bank.seen))


def admit(bank: Bank, levels: Level, score: Array, update: Array, method: Method) -> Bank:
    """Take new levels in: on trial only where they beat the worst, else instead of the oldest.

    Args:
        bank: the bank, of C levels.
        levels: `Level` with a leading axis [n], n <= C.
        score: float32 [n].
        update: number of this update.
        method: how the bank is renewed.
    """
    count = score.size
    standing = bank.score if method.on_trial else bank.serial.astype(jnp.float32)
    _, worst = jax.lax.top_k(-standing, count)
    best = jnp.argsort(-score)
    levels, score = jax.tree.map(lambda x: x[best], (levels, score))
    wins = score > bank.score[worst] if method.on_trial else jnp.ones(count, bool)
    serial = bank.serial.max() + 1 + jnp.arange(count, dtype=jnp.int32)
    new = Bank(levels, score, jnp.full(count, update), serial)
    place = jnp.where(wins, worst, bank.score.size)
    return jax.tree.map(lambda old, x: old.at[place].set(x, mode="drop"), bank, new)
