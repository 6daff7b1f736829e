"""The maze's world: longest shortest path, dynamics of the agent, its 5x5 view.

Headings are 0 right, 1 down, 2 left, 3 up. Of the agent's actions 0 turns left, 1 turns right, 2
drives forward and every other one does nothing. Whatever lies outside a layout is wall, so a layout
means the same with or without its ring of walls.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np

from qdenv.grid import MOVES, shift
from qdenv.lazy import jax, jnp
from qdenv.types import Array

TILES = " X"
EMPTY, WALL, GOAL = 0, 1, 2  # GOAL is a kind of view cell, not a tile
TURN_LEFT, TURN_RIGHT, FORWARD = 0, 1, 2
HEADINGS = np.array([(0, 1), (1, 0), (0, -1), (-1, 0)])  # (row, column) step of each heading
REACH = 4  # cells the view extends ahead; also the padding that makes every view fall inside
_CODES = np.array([(1, 0, 0), (2, 5, 0), (8, 1, 0)], np.float32)  # channels of empty, wall, goal


class Course(NamedTuple):
    """The first pair of the longest shortest path."""

    start: jax.Array  # int32, cell
    goal: jax.Array  # int32, cell
    length: jax.Array  # int32, moves from start to goal; 0 where no two empty tiles touch


class Pose(NamedTuple):
    """Where the agent is."""

    # int32, cell of the layout, or flat index of its `canvas` in `step` and in training
    position: jax.Array
    heading: jax.Array  # int32, 0..3


# A search from all sources: uint32 [H, W, words] of the sources that have reached each cell, and of
# those new in the last round with any; rounds; whether the last one had any.
_Spread: TypeAlias = tuple["jax.Array", "jax.Array", "jax.Array", "jax.Array"]


def longest_path(layout: Array) -> Course:
    """Find the two empty tiles of a layout (int8 [H, W]) that lie farthest apart.

    All sources spread at once, one bit each, so the last pairs to meet are the farthest; of these
    the smallest start wins, then the smallest goal (the published tie rule).
    """
    rows, cols = layout.shape
    cells = rows * cols
    free = (layout == EMPTY)[:, :, None]
    index = np.arange(cells)
    bits = np.zeros((cells, -(-cells // 32)), np.uint32)
    bits[index, index // 32] = np.uint32(1) << (index % 32).astype(np.uint32)
    own = jnp.where(free, bits.reshape(rows, cols, -1), np.uint32(0))

    def expand(now: _Spread) -> _Spread:
        seen, last, length, _ = now
        near = seen
        for move in MOVES:
            near = near | shift(seen, move)
        fresh = jnp.where(free, near, np.uint32(0)) & ~seen
        grew = fresh.any()
        return seen | fresh, jnp.where(grew, fresh, last), length + grew, grew

    first = (own, jnp.zeros_like(own), jnp.int32(0), jnp.bool_(True))
    _, last, length, _ = jax.lax.while_loop(lambda now: now[3], expand, first)
    last = last.reshape(cells, -1)
    source = jnp.bitwise_or.reduce(last, axis=0)  # sources that met a partner in the last round
    shifts = jnp.arange(32, dtype=jnp.uint32)
    start = jnp.argmax(((source[:, None] >> shifts[None]) & 1).reshape(-1)).astype(jnp.int32)
    goal = jnp.argmax((last[:, start // 32] >> (start % 32).astype(jnp.uint32)) & 1)
    return Course(start, goal.astype(jnp.int32), length)


def canvas(layout: Array, goal: Array) -> jax.Array:
    """Surround a layout with walls and mark its goal: int8 [H + 8, W + 8] of view kinds."""
    kinds = jnp.asarray(layout).reshape(-1).at[goal].set(GOAL).reshape(layout.shape)
    return jnp.pad(kinds, REACH, constant_values=WALL)


def view(kinds: Array, place: Array, heading: Array) -> jax.Array:
    """Read what the agent sees from a flat index of a `canvas` (int8 [5, 5] of kinds, [x, y]).

    x goes to the agent's right, y ahead of it to its own row, 4; walls hide nothing.
    """
    ahead = REACH - np.arange(5)[None, None, :, None]
    right = np.arange(5)[None, :, None, None] - 2
    facing = HEADINGS[:, None, None, :]
    sideways = np.roll(HEADINGS, -1, axis=0)[:, None, None, :]
    step = ahead * facing + right * sideways  # (rows, columns) by heading, x and y
    offsets = jnp.asarray((step[..., 0] * kinds.shape[1] + step[..., 1]).astype(np.int32))
    return jnp.asarray(kinds).reshape(-1)[place + offsets[heading]]


def image(kinds: Array) -> jax.Array:
    """Code a view for the network (int8 [..., 5, 5] -> float32 [..., 5, 5, 3], a tenth of ints)."""
    return (jnp.asarray(_CODES) / 10)[kinds.astype(jnp.int32)]


def step(kinds: Array, pose: Pose, action: Array | int) -> tuple[Pose, jax.Array]:
    """Act once on a `canvas`; `pose.position` is a flat index of it.

    Returns the new pose and whether the goal is reached; the agent never stands on the goal.
    """
    turn = jnp.where(action == TURN_RIGHT, 1, 0) - jnp.where(action == TURN_LEFT, 1, 0)
    strides = jnp.asarray(HEADINGS @ np.array([kinds.shape[1], 1]), jnp.int32)
    front = pose.position + strides[pose.heading]
    kind = kinds.reshape(-1)[front]
    forward = action == FORWARD
    position = jnp.where(forward & (kind == EMPTY), front, pose.position)
    return Pose(position, (pose.heading + turn) % 4), forward & (kind == GOAL)
