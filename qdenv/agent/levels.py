"""Levels for the maze agent to train on: random walls, textures, edits; start and goal pairs.

Every level lies on one canvas of fixed size, small ones in its corner amid walls. Half of the pairs
are the evaluation's own (the first pair of the longest shortest path), the others a random tile and
a random tile it can reach.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdenv.agent.settings import LevelConfig
from qdenv.simulate.maze.world import (
    EMPTY,
    GOAL,
    HEADINGS,
    REACH,
    WALL,
    Course,
    canvas,
    in_layout,
    longest_path,
    on_canvas,
)
from qdenv.types import Array

_LONGEST_PERIOD = 12  # of textures
_LARGE = 24  # rows and columns beyond which the longest path is approximated
_SWEEPS = 4  # random tiles from which that begins
_UNSEEN = 10_000  # distance of tiles that cannot reach the goal


class Level(NamedTuple):
    """One training level; places are flat indices of its canvas."""

    kinds: jax.Array  # int8 [size + 8, size + 8]
    start: jax.Array  # int32
    distance: jax.Array  # int16 [(size + 8)^2], moves to the goal
    horizon: jax.Array  # int32
    longest: jax.Array  # bool, the pair is the longest path's


def _walls(noise: jax.Array, count: jax.Array) -> jax.Array:
    """Put `count` walls where the noise (float32 [n, n]) is largest -> int8 [n, n]."""
    # The threshold lies above all noise for a count of 0.
    thresholds = jnp.append(jnp.sort(noise.reshape(-1)), jnp.inf)
    return (noise >= thresholds[noise.size - count]).astype(jnp.int8)


def draw_side(key: jax.Array, config: LevelConfig) -> jax.Array:
    """Draw the rows and columns of a maze (int32, consumes the key)."""
    return jax.random.randint(key, (), config.smallest or config.size, config.size + 1)


def draw_layout(key: jax.Array, config: LevelConfig, side: Array) -> jax.Array:
    """Draw a layout of random walls, or of a noisy linear texture (consumes the key).

    A texture repeats a random row of m values along a random lattice direction, which yields the
    stripes, diagonals and dashes that generators like to grow.

    Args:
        key: consumed.
        config: what levels look like.
        side: int32, rows and columns of the maze, which lies in the first corner of a solid
            layout.

    Returns:
        int8 [size, size].
    """
    n = config.size
    # One call for all random numbers: levels are drawn by the thousand.
    draws = jax.random.uniform(key, (n * n + _LONGEST_PERIOD + 6,))
    noise, pattern = draws[: n * n].reshape(n, n), draws[n * n : -6]
    amount, kind, rough, period, down, right = draws[-6:]
    row, col = jnp.meshgrid(jnp.arange(n), jnp.arange(n), indexing="ij")
    period = 3 + (period * (_LONGEST_PERIOD - 2)).astype(jnp.int32)
    down, right = (down * period).astype(jnp.int32), (right * period).astype(jnp.int32)
    texture = pattern[(down * row + right * col) % period] + (0.02 + 0.6 * rough) * noise
    field = jnp.where(kind < config.textured, texture, noise)
    inside = (row < side) & (col < side)
    most = config.most_walls * side**2 // n**2
    layout = _walls(jnp.where(inside, field, -1.0), (amount * (most + 1)).astype(jnp.int32))
    return jnp.where(inside, layout, WALL).astype(jnp.int8)


def _distances(kinds: jax.Array, goal: jax.Array) -> jax.Array:
    """Count the moves from every place of a canvas to the goal (int32 [(H + 8) (W + 8)])."""
    width = kinds.shape[1]
    free = (kinds != WALL).reshape(-1)
    strides = [int(row) * width + int(col) for row, col in HEADINGS]
    far = jnp.full(free.shape, _UNSEEN, jnp.int32).at[goal].set(0)

    def relax(carry: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        old, _ = carry
        # The ring of walls around a canvas keeps what rolls over its edge out.
        near = jnp.stack([jnp.roll(old, stride) for stride in strides]).min(0) + 1
        new = jnp.where(free, jnp.minimum(old, near), _UNSEEN)
        return new, (new != old).any()

    return jax.lax.while_loop(lambda carry: carry[1], relax, (far, jnp.bool_(True)))[0]


def far_pair(key: jax.Array, layout: jax.Array) -> Course:
    """Find two tiles about as far apart as any: the farthest one from the farthest one.

    Two breadth-first searches in place of one from every tile (`world.longest_path`), which costs
    a second at 64 x 64. Exact where the maze is a tree; the search begins in the largest of the
    components that a few random tiles lie in.

    Args:
        key: consumed.
        layout: int8 [n, n].

    Returns:
        places by cell of the layout; a length of 0 where no two empty tiles touch.
    """
    n = layout.shape[1]
    kinds = jnp.pad(layout, REACH, constant_values=WALL)
    free = (kinds != WALL).reshape(-1)
    # Random tiles among those with an empty neighbour, for the others begin no path.
    beside = jnp.stack(
        [jnp.roll(free, int(row) * (n + 2 * REACH) + int(col)) for row, col in HEADINGS]
    )
    useful = jnp.cumsum(free & beside.any(0))
    rank = (jax.random.uniform(key, (_SWEEPS,)) * useful[-1]).astype(jnp.int32)
    tiles = jnp.searchsorted(useful, rank, side="right")
    far = jax.vmap(lambda tile: _distances(kinds, tile))(tiles)
    gap = far[jnp.argmax((far < _UNSEEN).sum(1))]

    def farthest(gap: jax.Array) -> jax.Array:
        return jnp.argmax(jnp.where(gap < _UNSEEN, gap, -1))

    one = farthest(gap)
    gap = _distances(kinds, one)
    two = farthest(gap)
    length = jnp.where(useful[-1] > 0, gap[two], 0)
    return Course(in_layout(jnp.minimum(one, two), n), in_layout(jnp.maximum(one, two), n), length)


def _pair_up(key: jax.Array, layout: jax.Array, horizon: jax.Array, longest: jax.Array) -> Level:
    """Choose start and goal; a level without any pair gets one carved into its first corner."""
    keys = jax.random.split(key)
    large = layout.shape[0] > _LARGE
    course = far_pair(keys[1], layout) if large else longest_path(layout)
    broken = course.length < 1
    carved = layout.at[0, :2].set(EMPTY)
    layout = jnp.where(broken, carved, layout)
    start = jnp.where(broken, 0, course.start)
    goal = jnp.where(broken, 1, course.goal)
    n = layout.shape[1]
    far = canvas(layout, goal)
    there = jnp.where(far == GOAL, EMPTY, far).reshape(-1)
    place = on_canvas(goal, n)
    gap = _distances(far, place)
    # A random pair lies in the component of the longest path, where a partner is sure to exist.
    reachable = jnp.cumsum((gap < _UNSEEN) & (there == EMPTY))
    rank = (jax.random.uniform(keys[0], (2,)) * reachable[-1]).astype(jnp.int32)
    one, two = jnp.searchsorted(reachable, rank, side="right")
    swap = ~longest & (one != two)
    place = jnp.where(swap, one, place)
    begin = jnp.where(swap, two, on_canvas(start, n)).astype(jnp.int32)
    kinds = there.at[place].set(GOAL).reshape(far.shape).astype(jnp.int8)
    moves = _distances(kinds, place).astype(jnp.int16)
    return Level(kinds, begin, moves, horizon, longest)


def draw_level(key: jax.Array, config: LevelConfig) -> Level:
    """Draw a new level (domain randomisation); consumes the key."""
    layout_key, pair_key, key = jax.random.split(key, 3)
    side = draw_side(jax.random.fold_in(key, 1), config)
    low, high = (steps * (side + 2) ** 2 // (config.size + 2) ** 2 for steps in config.horizon)
    span, kind = jax.random.uniform(key, (2,))
    horizon = low + (span * (high + 1 - low)).astype(jnp.int32)
    layout = draw_layout(layout_key, config, side)
    return _pair_up(pair_key, layout, horizon, kind < config.longest)


def vary_level(key: jax.Array, level: Level, config: LevelConfig) -> Level:
    """Flip a few tiles of a level and pair it again, the edit of ACCEL; consumes the key.

    Parker-Holder et al. 2022, https://arxiv.org/abs/2203.01302.
    """
    keys = jax.random.split(key, 2)
    n = config.size
    inner = level.kinds[4 : 4 + n, 4 : 4 + n]
    layout = jnp.where(inner == WALL, WALL, EMPTY).astype(jnp.int8).reshape(-1)
    cells = jax.random.randint(keys[0], (config.edits,), 0, n * n)
    layout = layout.at[cells].set(1 - layout[cells]).reshape(n, n)
    return _pair_up(keys[1], layout, level.horizon, level.longest)


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
