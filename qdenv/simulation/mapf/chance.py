"""Chance in a simulation: random bits as a function of a seed and a number.

Both backends run these functions as they stand: `jnp` traces them on uint32 arrays, numba compiles
them on machine integers. So a whole run draws the same bits wherever it happens, in any order, and
no stream has to be carried along.
"""

from __future__ import annotations

import functools
from typing import Any, TypeVar

import numpy as np

from qdenv.lazy import jax, jnp
from qdenv.native import shared
from qdenv.types import Array

Bits = TypeVar("Bits", int, jax.Array, np.ndarray)  # 32 of them

# Of numpy's type: both backends then compute in 32 bits.
_MASK: Any = np.uint32(0xFFFFFFFF)
_GOLDEN: Any = np.uint32(0x9E3779B9)  # added to a number, so that 0 is not drawn for 0
_FIRST: Any = np.uint32(0x7FEB352D)
_SECOND: Any = np.uint32(0x846CA68B)
CHANCE_BITS = 24  # exact in a float32

# What a number is drawn for: each purpose has different bits.
STARTS, FIRST_GOAL, SECOND_GOAL, GOALS, PLANS, NEXT_RUN, ORDERS = range(7)  # by a run
ORDER, TIES, RESORT = range(3)  # by a planner, of the seed of a window


@shared
def _scramble(bits: Bits) -> Bits:
    """Mix 32 bits so that each depends on all, by the hash "lowbias32" of C. Wellons.

    https://nullprogram.com/blog/2018/07/31/
    """
    bits = bits ^ (bits >> 16)
    bits = (bits * _FIRST) & _MASK
    bits = bits ^ (bits >> 15)
    bits = (bits * _SECOND) & _MASK
    return bits ^ (bits >> 16)


@shared
def mix(seed: Bits, number: Bits) -> Bits:
    """Draw the 32 bits of a number; different seeds give unrelated bits."""
    return _scramble(seed ^ _scramble((number + _GOLDEN) & _MASK))


def draw_on_host(seed: np.ndarray | int, number: np.ndarray | int) -> np.ndarray:
    """Draw the bits of numbers in numpy (uint32 [n]), as `mix` does one by one."""
    return mix(*(np.atleast_1d(part).astype(np.uint32) for part in (seed, number)))


def draw(seed: Array | int, number: Array | int) -> jax.Array:
    """Draw the bits of numbers in XLA (uint32), as `mix` does on the host."""
    return mix(jnp.asarray(seed).astype(jnp.uint32), jnp.asarray(number).astype(jnp.uint32))


def poisson(mean: float) -> np.ndarray:
    """Make the table from which numbers of events are drawn, on average `mean` (int32 [n]).

    The odds of at most 0, 1, 2, ... events, in units of a draw of `CHANCE_BITS` bits: as many
    events happen as entries are not above the draw.
    """
    steps = np.arange(1, int(mean + 10 * np.sqrt(mean)) + 10)
    odds = np.exp(-mean) * np.cumsum(np.append(1.0, np.cumprod(mean / steps)))
    return np.floor(odds * 2.0**CHANCE_BITS).astype(np.int32)


def seed_of(key: jax.Array) -> jax.Array:
    """Make a seed (uint32) of a key of `jax.random`, of whichever kind."""
    words = key if jnp.issubdtype(key.dtype, jnp.uint32) else jax.random.key_data(key)
    return functools.reduce(draw, words.reshape(-1).astype(jnp.uint32))
