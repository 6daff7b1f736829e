"""Scores of a layout alone: entropy, components, counts, similarity."""

from __future__ import annotations

import math

from qdenv.grid import count_components, of_tiles
from qdenv.lazy import chex, jax, jnp
from qdenv.types import Array


def entropy(area: Array, kinds: int) -> jax.Array:
    """Measure how irregular a layout is: Shannon entropy of its 2x2 patterns.

    The logarithm's base is the number of possible patterns, ``kinds ** 4``, so the result lies
    in [0, 1] (environment entropy, section 4 of the paper). The generated area is int8 [h, w], of
    tiles below `kinds`; the result is float32, 0 for an area without a 2x2 window.
    """
    chex.assert_rank(area, 2)
    tiles = area.astype(jnp.int32)
    corners = (tiles[:-1, :-1], tiles[:-1, 1:], tiles[1:, :-1], tiles[1:, 1:])
    # A pattern is a number of four digits in base `kinds`.
    codes = sum(corner * kinds**power for power, corner in enumerate(corners))
    if codes.size == 0:
        return jnp.float32(0)
    counts = jnp.zeros(kinds**4, jnp.int32).at[codes.reshape(-1)].add(1)
    share = counts / codes.size
    return -jax.scipy.special.xlogy(share, share).sum() / (4 * math.log(kinds))


def components(layout: Array, symbols: str, tiles: str) -> jax.Array:
    """Count 4-connected components of cells holding one of `symbols` (-> float32)."""
    return count_components(of_tiles(layout, symbols, tiles)).astype(jnp.float32)


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
