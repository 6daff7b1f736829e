"""Which levels the agent trains on: domain randomisation, robust PLR, ACCEL.

A buffer of levels is replayed; a method says how new levels come about and whether they must first
prove worth training on. The score of a level is its mean positive advantage, "positive value loss".

* Prioritized level replay: Jiang, Grefenstette and Rocktäschel 2021,
  https://arxiv.org/abs/2010.03934.
* Robust PLR, which learns from replayed levels only: Jiang et al. 2021, "Replay-guided adversarial
  environment design", https://arxiv.org/abs/2110.02439.
* ACCEL, which edits levels of the buffer: Parker-Holder et al. 2022, "Evolving curricula with
  regret-based environment design", https://arxiv.org/abs/2203.01302.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdenv.agent.levels import Level, draw_level, vary_level
from qdenv.agent.settings import LevelConfig


class LevelBuffer(NamedTuple):
    """The levels under replay, each with a leading axis [C]."""

    level: Level
    score: jax.Array  # float32, mean positive advantage when last seen
    last_seen: jax.Array  # int32, update at which it was last scored
    serial: jax.Array  # int32, number of the level since the beginning


class Method(NamedTuple):
    """How the buffer is renewed."""

    # (key, buffer, replay probabilities [C], config) -> one new level; consumes the key
    propose: Callable[[jax.Array, LevelBuffer, jax.Array, LevelConfig], Level]
    # new levels are tried without learning and enter by score (robust PLR); else each replaces the
    # oldest level, and all levels are replayed alike
    on_trial: bool


def _draw(
    key: jax.Array, buffer: LevelBuffer, probabilities: jax.Array, config: LevelConfig
) -> Level:
    del buffer, probabilities
    return draw_level(key, config)


def _draw_or_edit(
    key: jax.Array, buffer: LevelBuffer, probabilities: jax.Array, config: LevelConfig
) -> Level:
    """Edit a level that is worth replaying, or draw a new one, each in half of the cases."""
    keys = jax.random.split(key, 4)
    parent = jax.random.choice(keys[0], probabilities.shape[0], p=probabilities)
    edited = vary_level(keys[1], jax.tree.map(lambda x: x[parent], buffer.level), config)
    new = draw_level(keys[2], config)
    return jax.tree.map(lambda a, b: jnp.where(jax.random.bernoulli(keys[3]), a, b), edited, new)


METHODS: dict[str, Method] = {
    "dr": Method(_draw, on_trial=False),
    "plr": Method(_draw, on_trial=True),
    "accel": Method(_draw_or_edit, on_trial=True),
}


def new_buffer(key: jax.Array, size: int, config: LevelConfig) -> LevelBuffer:
    """Fill a buffer with drawn levels, a few at a time; consumes the key."""
    level = jax.lax.map(
        lambda k: draw_level(k, config), jax.random.split(key, size), batch_size=min(size, 64)
    )
    zeros = jnp.zeros(size, jnp.int32)
    return LevelBuffer(level, jnp.zeros(size), zeros, jnp.arange(size, dtype=jnp.int32))


def replay_probabilities(
    buffer: LevelBuffer, update: jax.Array, method: Method, staleness: float = 0.3
) -> jax.Array:
    """Weigh the levels for replay: evenly, or by score with a share for those long unseen.

    The mixture P = (1 - staleness) P_score + staleness P_age of prioritized level replay, both
    parts in proportion (PLR ranks the scores): a score is only as good as the policy it was
    measured with, so old ones must be measured again.

    Returns:
        float32 [C], sums to 1.
    """
    if not method.on_trial:
        return jnp.full(buffer.score.shape, 1 / buffer.score.size)
    # The small number keeps a buffer without any score from dividing by zero.
    by_score = (buffer.score + 1e-6) / (buffer.score + 1e-6).sum()
    age = (update - buffer.last_seen + 1).astype(jnp.float32)
    return (1 - staleness) * by_score + staleness * age / age.sum()


def update_scores(
    buffer: LevelBuffer,
    update: jax.Array,
    slot: jax.Array,
    serial: jax.Array,
    advantage: jax.Array,
) -> LevelBuffer:
    """Score the levels that were just played by their mean positive advantage.

    Args:
        buffer: of C levels.
        update: number of this update.
        slot: int32 [...], place in the buffer of the level played at each step.
        serial: int32 [...], its number; steps of levels that have left the buffer are ignored.
        advantage: float32 [...].
    """
    size = buffer.score.size
    # Environments play on while their level is replaced: the serial tells, and slot C is nowhere.
    slot = jnp.where(buffer.serial[slot] == serial, slot, size).reshape(-1)
    positive = jnp.maximum(advantage, 0).reshape(-1)
    total = jnp.zeros(size).at[slot].add(positive, mode="drop")
    count = jnp.zeros(size).at[slot].add(1.0, mode="drop")
    played = count > 0
    score = jnp.where(played, total / jnp.maximum(count, 1), buffer.score)
    return buffer._replace(score=score, last_seen=jnp.where(played, update, buffer.last_seen))


def insert(
    buffer: LevelBuffer, levels: Level, score: jax.Array, update: jax.Array, method: Method
) -> LevelBuffer:
    """Take new levels in: on trial only where they beat the worst, else instead of the oldest.

    Args:
        buffer: of C levels.
        levels: `Level` with a leading axis [n], n <= C.
        score: float32 [n].
        update: number of this update.
        method: how the buffer is renewed.
    """
    count = score.size
    rank = buffer.score if method.on_trial else buffer.serial.astype(jnp.float32)
    _, worst = jax.lax.top_k(-rank, count)
    # The best newcomer meets the worst resident, the second best the second worst, and so on.
    best = jnp.argsort(-score)
    levels, score = jax.tree.map(lambda x: x[best], (levels, score))
    wins = score > buffer.score[worst] if method.on_trial else jnp.ones(count, bool)
    serial = buffer.serial.max() + 1 + jnp.arange(count, dtype=jnp.int32)
    new = LevelBuffer(levels, score, jnp.full(count, update), serial)
    slot = jnp.where(wins, worst, buffer.score.size)  # losers: out of bounds
    return jax.tree.map(lambda old, x: old.at[slot].set(x, mode="drop"), buffer, new)
