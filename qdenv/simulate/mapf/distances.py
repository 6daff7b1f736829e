"""Shortest distances from every goal to every cell, all goals at once, one bit per goal."""

from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp

from qdenv.grid import MOVES, shift

Planes: TypeAlias = tuple[jax.Array, ...]

UNREACHABLE = 8191  # farther than any shortest path of a usable layout; small enough to add up
PLANES = 4  # bits of the step counter that is unpacked once per epoch
WORD = 32


class _Wave(NamedTuple):
    """The breadth-first search between two epochs.

    Attributes:
        reached: uint32 [G / 32, H, W], one bit per goal.
        distance: int16 [G, H * W], steps for which each cell has been out of reach.
        grew: bool, the last epoch reached new cells.
    """

    reached: jax.Array
    distance: jax.Array
    grew: jax.Array


def pack_goals(cells: jax.Array, used: jax.Array, shape: tuple[int, int]) -> jax.Array:
    """Set bit ``g % 32`` of word ``g // 32`` at the cell of goal g (uint32 [G / 32, H, W])."""
    count = cells.shape[0]
    words = -(-count // WORD)
    slot = jnp.arange(count)
    bit = jnp.where(used, jnp.uint32(1) << (slot % WORD).astype(jnp.uint32), jnp.uint32(0))
    empty = jnp.zeros((words, shape[0] * shape[1]), jnp.uint32)
    return empty.at[slot // WORD, cells].add(bit).reshape(words, *shape)


def goal_distances(traversable: jax.Array, cells: jax.Array, used: jax.Array) -> jax.Array:
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
    start = pack_goals(cells, used, (rows, cols)) & open_cells[None]

    def step(_: jax.Array, carry: tuple[jax.Array, Planes]) -> tuple[jax.Array, Planes]:
        reached, planes = carry
        carry_bit, sums = ~reached, []
        for plane in planes:  # a ripple-carry counter, one bit plane after the other
            sums.append(plane ^ carry_bit)
            carry_bit = plane & carry_bit
        after = reached
        for move in MOVES:
            after = after | jax.vmap(lambda word, move=move: shift(word, move))(reached)
        return after & open_cells[None], tuple(sums)

    def unpack(words: jax.Array) -> jax.Array:
        bits = (words[:, None] >> jnp.arange(WORD, dtype=jnp.uint32)[None, :, None, None]) & 1
        return bits.astype(jnp.int16).reshape(-1, rows * cols)[:count]

    def epoch(wave: _Wave) -> _Wave:
        planes = (jnp.zeros_like(wave.reached),) * PLANES
        reached, planes = jax.lax.fori_loop(0, 2**PLANES - 1, step, (wave.reached, planes))
        distance = wave.distance
        for bit, plane in enumerate(planes):
            distance = distance + (unpack(plane) << bit)
        return _Wave(reached, distance, (reached != wave.reached).any())

    first = _Wave(start, jnp.zeros((count, rows * cols), jnp.int16), jnp.bool_(True))
    wave = jax.lax.while_loop(lambda wave: wave.grew, epoch, first)
    return jnp.where(unpack(wave.reached) == 1, wave.distance, jnp.int16(UNREACHABLE))
