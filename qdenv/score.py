"""Scores of a layout alone: entropy, components, counts, similarity."""

from __future__ import annotations

import functools
import math

from qdenv.grid import MOVES, fixed_point, of_tiles, shift
from qdenv.lazy import chex, jax, jnp
from qdenv.types import Array


def entropy(area: Array, kinds: int, partial: bool = False) -> jax.Array:
    """Measure how irregular a layout is: Shannon entropy of its 2x2 patterns.

    The logarithm's base is the number of possible patterns, ``kinds ** 4``, so the result lies
    in [0, 1] (environment entropy, section 4 of the paper). The generated area is int8 [h, w], of
    tiles below `kinds`; with `partial`, other tiles may occur, and patterns with one do not count.
    The result is float32, 0 for an area without a 2x2 window.
    """
    chex.assert_rank(area, 2)
    tiles = area.astype(jnp.int32)
    corners = (tiles[:-1, :-1], tiles[:-1, 1:], tiles[1:, :-1], tiles[1:, 1:])
    # A pattern is a number of four digits in base `kinds`.
    codes = sum(corner * kinds**power for power, corner in enumerate(corners))
    if codes.size == 0:
        return jnp.float32(0)
    own = functools.reduce(jnp.logical_and, [corner < kinds for corner in corners])
    # A pattern that does not count is out of range, and dropped.
    codes = jnp.where(own, codes, kinds**4) if partial else codes
    counts = jnp.zeros(kinds**4, jnp.int32).at[codes.reshape(-1)].add(1, mode="drop")
    share = counts / (jnp.maximum(counts.sum(), 1) if partial else codes.size)
    return -jax.scipy.special.xlogy(share, share).sum() / (4 * math.log(kinds))


def components(layout: Array, symbols: str, tiles: str) -> jax.Array:
    """Count 4-connected components of cells holding one of `symbols` (-> float32)."""
    mask = jnp.asarray(of_tiles(layout, symbols, tiles))
    rows, cols = mask.shape
    labels = jnp.where(mask, jnp.arange(rows * cols, dtype=jnp.int32).reshape(rows, cols), -1)

    def pass_on(old: jax.Array) -> jax.Array:
        new = functools.reduce(jnp.maximum, [shift(old, move, -1) for move in MOVES], old)
        new = jnp.where(mask, new, -1)
        # Pointer jumping: a label names a cell, whose own label is at least as large.
        return jnp.where(mask, jnp.maximum(new, new.reshape(-1)[new]), -1)

    roots = fixed_point(pass_on, labels).reshape(-1) == jnp.arange(rows * cols)
    return (roots & mask.reshape(-1)).sum(dtype=jnp.int32).astype(jnp.float32)


def count(layout: Array, symbols: str, tiles: str) -> jax.Array:
    """Count the cells holding one of `symbols` (-> float32)."""
    return of_tiles(layout, symbols, tiles).sum().astype(jnp.float32)


def similarity(unrepaired: Array, repaired: Array, weight: Array) -> jax.Array:
    """Score how little the repair changed: Delta of the paper's section 4 (float32 in [0, 1]).

    The summed weight of the unchanged cells per cell; layouts are int8 [H, W], `weight` is
    p_i / max p of each cell, float32 [H, W] in [0, 1].
    """
    chex.assert_equal_shape([unrepaired, repaired, weight])
    return ((unrepaired == repaired) * weight).mean(dtype=jnp.float32)
