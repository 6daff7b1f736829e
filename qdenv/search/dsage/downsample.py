"""Downsampling: of every block of an archive's cells one elite, drawn at random, is evaluated."""

import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from qdenv.search.archive import GridArchive
from qdenv.types import InputError, Measure


def blocks_along(measures: Sequence[Measure], wanted: Sequence[int]) -> tuple[int, ...]:
    """Give the number of blocks along each measure: those wanted, no more than there are cells.

    Half of the cells along the first measure and a quarter along the others where none are wanted,
    as published for the warehouse.

    Raises:
        InputError: the number of axes is another.
    """
    if wanted and len(wanted) != len(measures):
        raise InputError(f"downsample: give {len(measures)} numbers of blocks, one per measure")
    usual = [axis.cells // (4 if place else 2) for place, axis in enumerate(measures)]
    asked = wanted or usual
    return tuple(
        max(1, min(blocks, axis.cells)) for blocks, axis in zip(asked, measures, strict=True)
    )


def block_of_cells(measures: Sequence[Measure], blocks: Sequence[int]) -> np.ndarray:
    """Say in which block each cell lies (int32 [C]); blocks are as equal as whole cells allow."""
    shape = tuple(axis.cells for axis in measures)
    cells = np.unravel_index(np.arange(math.prod(shape)), shape)
    along = [
        index * count // axis.cells
        for index, axis, count in zip(cells, measures, blocks, strict=True)
    ]
    return np.ravel_multi_index(tuple(along), tuple(blocks)).astype(np.int32)


def draw_per_block(key: jax.Array, filled: jax.Array, block: np.ndarray) -> jax.Array:
    """Mark one filled cell of each block that has any (bool [C]). Consumes `key`.

    Args:
        key: consumed.
        filled: bool [C].
        block: int32 [C], from `block_of_cells`.
    """
    # A random order in place of random numbers: no two cells of a block are ever equal.
    rank = jnp.where(filled, jax.random.permutation(key, len(block)), -1)
    best = jax.ops.segment_max(rank, block, num_segments=int(block.max()) + 1)
    return filled & (rank == best[block])


def choose_waiting(
    key: jax.Array, found: GridArchive, block: np.ndarray, fresh: jax.Array, batch: int
) -> tuple[jax.Array, jax.Array]:
    """Choose what is evaluated next: an elite of each block, and others up to whole batches.

    Where the archive has too few elites for that, random solutions fill the last batch.

    Args:
        key: consumed.
        found: of the inner loop; solutions int8 [C, P].
        block: int32 [C], from `block_of_cells`.
        fresh: int8 [Q, P], random solutions; Q holds a batch more than there are blocks.
        batch: true evaluations per iteration.

    Returns:
        the queue int8 [Q, P], and how many of its first rows wait (int32).
    """
    block_key, order_key = jax.random.split(key)
    drawn, cells, room = draw_per_block(block_key, found.filled, block), len(block), len(fresh)
    order = jax.random.uniform(order_key, drawn.shape)
    worth = jnp.where(found.filled, order + drawn, -1.0)  # drawn before others, others before none
    worth = jnp.pad(worth, (0, max(room - cells, 0)), constant_values=-1.0)
    value, cell = jax.lax.top_k(worth, room)
    elites = found.genotypes[jnp.minimum(cell, cells - 1)]
    waiting = jnp.maximum((drawn.sum(dtype=jnp.int32) + batch - 1) // batch, 1) * batch
    return jnp.where((value >= 0)[:, None], elites, fresh), waiting
