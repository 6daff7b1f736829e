"""Levels for the maze agent to train on: random walls, textures, edits; start and goal pairs.

All levels have canvases of one size; small ones lie in the first corner amid walls.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qdenv.agent.settings import LevelConfig
from qdenv.grid import count_neighbours, fixed_point, move_steps, pad
from qdenv.simulation.maze import world
from qdenv.simulation.maze.world import EMPTY, GOAL, REACH, WALL
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


def draw_layout(key: jax.Array, config: LevelConfig, side: Array) -> jax.Array:
    """Draw a layout of random walls, or of a noisy linear texture (int8 [size, size]).

    A texture repeats a random row of m values along a random lattice direction, which yields the
    stripes, diagonals and dashes that generators like to grow. The maze has `side` rows and columns
    (int32) and lies in the first corner of a solid layout. Consumes the key.
    """
    n = config.size
    # One call for all random numbers: levels are drawn by the thousand.
    draws = jax.random.uniform(key, (n * n + _LONGEST_PERIOD + 6,))
    noise, pattern = draws[: n * n].reshape(n, n), draws[n * n : -6]
    amount, kind, rough, period, down, right = draws[-6:]
    row, col = jnp.indices((n, n))
    period = 3 + (period * (_LONGEST_PERIOD - 2)).astype(jnp.int32)
    down, right = (down * period).astype(jnp.int32), (right * period).astype(jnp.int32)
    texture = pattern[(down * row + right * col) % period] + (0.02 + 0.6 * rough) * noise
    inside = (row < side) & (col < side)
    field = jnp.where(inside, jnp.where(kind < config.textured, texture, noise), -1.0)
    most = jnp.asarray(min(config.most_walls, n**2) * np.arange(n + 1) ** 2 // n**2)[side]
    count = (amount * (most + 1)).astype(jnp.int32)
    # Walls where the field is largest; the threshold lies above all of it for a count of 0.
    thresholds = jnp.append(jnp.sort(field.reshape(-1)), jnp.inf)
    is_wall = field >= thresholds[field.size - count]
    return (is_wall | ~inside).astype(jnp.int8)


def _distances(kinds: jax.Array, goal: jax.Array) -> jax.Array:
    """Count the moves from every place of a canvas to the goal (int32 [(H + 8) (W + 8)])."""
    free = (kinds != WALL).reshape(-1)
    strides = move_steps(kinds.shape[1])[1:].tolist()
    far = jnp.full(free.shape, _UNSEEN, jnp.int32).at[goal].set(0)

    def relax(old: jax.Array) -> jax.Array:
        # The ring of walls around a canvas keeps what rolls over its edge out.
        near = jnp.stack([jnp.roll(old, stride) for stride in strides]).min(0) + 1
        return jnp.where(free, jnp.minimum(old, near), _UNSEEN)

    return fixed_point(relax, far)


def far_pair(key: jax.Array, layout: jax.Array) -> world.Course:
    """Find two tiles about as far apart as any: the farthest one from the farthest one.

    A few breadth-first searches in place of one from every tile (`world.longest_path`). Exact where
    the maze is a tree; the search begins in the largest of the components that a few random tiles
    lie in. The length is 0 where no two empty tiles touch. Consumes the key.
    """
    n = layout.shape[1]
    kinds = jnp.pad(layout, REACH, constant_values=WALL)
    free = kinds != WALL
    # Random tiles among those with an empty neighbour, for the others begin no path.
    useful = jnp.cumsum(free & (count_neighbours(free) > 0))
    rank = (jax.random.uniform(key, (_SWEEPS,)) * useful[-1]).astype(jnp.int32)
    tiles = jnp.searchsorted(useful, rank, side="right")
    far = jax.vmap(lambda tile: _distances(kinds, tile))(tiles)
    begin = far[jnp.argmax((far < _UNSEEN).sum(1))]
    one = jnp.argmax(jnp.where(begin < _UNSEEN, begin, -1))
    gap = _distances(kinds, one)
    two = jnp.argmax(jnp.where(gap < _UNSEEN, gap, -1))
    length = jnp.where(useful[-1] > 0, gap[two], 0)
    start, goal = pad(jnp.sort(jnp.stack([one, two])), n + 2 * REACH, -REACH).astype(jnp.int32)
    return world.Course(start, goal, length)


def _pair_up(key: jax.Array, layout: jax.Array, horizon: jax.Array, longest: jax.Array) -> Level:
    """Choose start and goal: the longest path's, or a random tile and one that it can reach."""
    keys, n = jax.random.split(key), layout.shape[1]
    course = far_pair(keys[1], layout) if n > _LARGE else world.longest_path(layout)
    # A maze in which no two tiles touch gets a pair carved into its first corner.
    broken = course.length < 1
    layout = jnp.where(broken, layout.at[0, :2].set(EMPTY), layout)
    start, goal = jnp.where(broken, 0, course.start), jnp.where(broken, 1, course.goal)
    far, place = world.canvas(layout, goal), pad(goal, n, REACH)
    there = jnp.where(far == GOAL, EMPTY, far).reshape(-1)
    # A random pair lies in the component of the longest path, where a partner is sure to exist.
    reachable = jnp.cumsum((_distances(far, place) < _UNSEEN) & (there == EMPTY))
    rank = (jax.random.uniform(keys[0], (2,)) * reachable[-1]).astype(jnp.int32)
    one, two = jnp.searchsorted(reachable, rank, side="right")
    swap = ~longest & (one != two)
    place = jnp.where(swap, one, place)
    begin = jnp.where(swap, two, pad(start, n, REACH)).astype(jnp.int32)
    kinds = there.at[place].set(GOAL).reshape(far.shape).astype(jnp.int8)
    return Level(kinds, begin, _distances(kinds, place).astype(jnp.int16), horizon, longest)


def draw_level(key: jax.Array, config: LevelConfig) -> Level:
    """Draw a new level (domain randomisation); consumes the key."""
    layout_key, pair_key, key = jax.random.split(key, 3)
    smallest = config.smallest or config.size
    side = jax.random.randint(jax.random.fold_in(key, 1), (), smallest, config.size + 1)
    areas = np.arange(2, config.size + 3) ** 2  # by side, with the frame; products need 64 bits
    low, high = (jnp.asarray(np.maximum(n * areas // areas[-1], 1))[side] for n in config.horizon)
    span, kind = jax.random.uniform(key, (2,))
    horizon = low + (span * (high + 1 - low)).astype(jnp.int32)
    layout = draw_layout(layout_key, config, side)
    return _pair_up(pair_key, layout, horizon, kind < config.longest)


def vary_level(key: jax.Array, level: Level, config: LevelConfig) -> Level:
    """Flip a few of its size x size tiles and pair it again, the edit of ACCEL; consumes the key.

    Parker-Holder et al. 2022, https://arxiv.org/abs/2203.01302.
    """
    keys, n = jax.random.split(key, 2), config.size
    inner = level.kinds[REACH : REACH + n, REACH : REACH + n]
    layout = (inner == WALL).astype(jnp.int8).reshape(-1)
    cells = jax.random.randint(keys[0], (config.edits,), 0, n * n)
    layout = layout.at[cells].set(1 - layout[cells]).reshape(n, n)
    return _pair_up(keys[1], layout, level.horizon, level.longest)


class LevelBuffer(NamedTuple):
    """The levels under replay, each with a leading axis [C].

    Methods of training on trial (robust PLR, https://arxiv.org/abs/2110.02439, and ACCEL) try new
    levels without learning, and those enter by score; else each replaces the oldest, and all are
    replayed alike.
    """

    level: Level
    score: jax.Array  # float32, mean positive advantage when last seen
    last_seen: jax.Array  # int32, update at which it was last scored
    serial: jax.Array  # int32, number of the level since the beginning


def new_buffer(key: jax.Array, size: int, config: LevelConfig) -> LevelBuffer:
    """Fill a buffer with drawn levels, a few at a time; consumes the key."""
    level = jax.lax.map(
        lambda k: draw_level(k, config), jax.random.split(key, size), batch_size=min(size, 64)
    )
    zeros = jnp.zeros(size, jnp.int32)
    return LevelBuffer(level, jnp.zeros(size), zeros, jnp.arange(size, dtype=jnp.int32))


def replay_probabilities(
    buffer: LevelBuffer, update: jax.Array, on_trial: bool, staleness: float = 0.3
) -> jax.Array:
    """Weigh the levels for replay: evenly, or by score with a share for age (float32 [C], sum 1).

    The mixture P = (1 - staleness) P_score + staleness P_age of prioritized level replay, both
    parts in proportion (PLR ranks the scores): a score is only as good as the policy it was
    measured with, so old ones must be measured again.
    """
    if not on_trial:
        return jnp.full(buffer.score.shape, 1 / buffer.score.size)
    # The small number keeps a buffer without any score from dividing by zero.
    by_score = (buffer.score + 1e-6) / (buffer.score + 1e-6).sum()
    age = (update - buffer.last_seen + 1).astype(jnp.float32)
    return (1 - staleness) * by_score + staleness * age / age.sum()


def update_scores(
    buffer: LevelBuffer, update: jax.Array, slot: jax.Array, serial: jax.Array, advantage: jax.Array
) -> LevelBuffer:
    """Score the levels that were just played by their mean positive advantage.

    Each step (any shape) has the slot of its level in the buffer, the level's serial number and its
    advantage. Steps of levels that have left the buffer are ignored.
    """
    size = buffer.score.size
    # Environments play on while their level is replaced: the serial shows it, and slot C is out of
    # bounds.
    slot = jnp.where(buffer.serial[slot] == serial, slot, size).reshape(-1)
    total = jnp.zeros(size).at[slot].add(jnp.maximum(advantage, 0).reshape(-1), mode="drop")
    count = jnp.zeros(size).at[slot].add(1.0, mode="drop")
    played = count > 0
    score = jnp.where(played, total / jnp.maximum(count, 1), buffer.score)
    return buffer._replace(score=score, last_seen=jnp.where(played, update, buffer.last_seen))


def insert(
    buffer: LevelBuffer, levels: Level, score: jax.Array, update: jax.Array, on_trial: bool
) -> LevelBuffer:
    """Take n <= C new levels in: on trial where they beat the worst, else instead of the oldest."""
    count = score.size
    rank = buffer.score if on_trial else buffer.serial.astype(jnp.float32)
    _, worst = jax.lax.top_k(-rank, count)
    # The best newcomer meets the worst resident, the second best the second worst, and so on.
    best = jnp.argsort(-score)
    levels, score = jax.tree.map(lambda x: x[best], (levels, score))
    wins = score > buffer.score[worst] if on_trial else jnp.ones(count, bool)
    serial = buffer.serial.max() + 1 + jnp.arange(count, dtype=jnp.int32)
    new = LevelBuffer(levels, score, jnp.full(count, update), serial)
    slot = jnp.where(wins, worst, buffer.score.size)  # losers: out of bounds
    return jax.tree.map(lambda old, x: old.at[slot].set(x, mode="drop"), buffer, new)
