"""Shortest distances from every goal to every cell, all goals at once, one bit per goal."""

import jax
import jax.numpy as jnp

from qdenv.grid import MOVES, shift
from qdenv.types import Array

UNREACHABLE = 8191  # farther than any shortest path of a usable layout; small enough to add up
PLANES = 4  # bits of the step counter that is unpacked once per epoch
WORD = 32


def pack_goals(cells: Array, used: Array, shape: tuple[int, int]) -> jax.Array:
    """Set bit ``g % 32`` of word ``g // 32`` at the cell of goal g (uint32 [G / 32, H, W])."""
    count = cells.shape[0]
    words = -(-count // WORD)
    slot = jnp.arange(count)
    bit = jnp.where(used, jnp.uint32(1) << (slot % WORD).astype(jnp.uint32), jnp.uint32(0))
    empty = jnp.zeros((words, shape[0] * shape[1]), jnp.uint32)
    return empty.at[slot // WORD, cells].add(bit).reshape(words, *shape)


def goal_distances(traversable: Array, cells: Array, used: Array) -> jax.Array:
    """Measure the way from every cell to every goal by breadth-first search.

    All goals spread at the same time, 32 to a word. How long a cell stayed out of reach is counted
    in four bit planes that are added to the distances after every 15 steps.

    Args:
        traversable: bool [H, W].
        cells: int32 [G], goal cells.
        used: bool [G], slots that hold a goal.

    Returns:
        int16 [G, H * W]; `UNREACHABLE` where no way leads, and in unused slots.
    """
    rows, cols = traversable.shape
    count = cells.shape[0]
    open_cells = jnp.where(traversable, jnp.uint32(0xFFFFFFFF), jnp.uint32(0))
    start = pack_goals(cells, used, (rows, cols)) & open_cells

    def step(_: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        reached, planes = carry
        carry_bit, sums = ~reached, []
        for plane in planes:  # a ripple-carry counter, one bit plane after the other
            sums.append(plane ^ carry_bit)
            carry_bit = plane & carry_bit
        spread = reached
        for move in MOVES:
            spread = spread | jax.vmap(lambda word, move=move: shift(word, move))(reached)
        return spread & open_cells, tuple(sums)

    def unpack(words: Array) -> jax.Array:
        bits = (words[:, None] >> jnp.arange(WORD, dtype=jnp.uint32)[None, :, None, None]) & 1
        return bits.astype(jnp.int16).reshape(-1, rows * cols)[:count]

    def epoch(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        reached, distance, _ = carry
        planes = tuple(jnp.zeros_like(reached) for _ in range(PLANES))
        after, planes = jax.lax.fori_loop(0, 2**PLANES - 1, step, (reached, planes))
        for bit, plane in enumerate(planes):
            distance = distance + (unpack(plane) << bit)
        return after, distance, (after != reached).any()

    zero = jnp.zeros((count, rows * cols), jnp.int16)
    reached, distance, _ = jax.lax.while_loop(
        lambda carry: carry[2], epoch, (start, zero, jnp.bool_(True))
    )
    return jnp.where(unpack(reached) == 1, distance, jnp.int16(UNREACHABLE))
