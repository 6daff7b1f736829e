"""Which cells and edges the planned agents use at each timestep, packed in bits.

Five planes per timestep t of the window: plane 0 marks cells occupied at t + 1; planes 1 to 4 mark
cells that an agent leaves between t and t + 1 by a move to the right, left, down or up. An agent
that enters such a cell against the move would swap places, so the swap test is a bit test at the
cell entered. Rows of cells are cut into overlapping words: word j holds columns 11 j to 11 j + 31,
so that the 21 columns around any cell lie within a single word.

Reserved paths never conflict, hence every bit has one owner, and bits are set and cleared by adding
and subtracting words.
"""

import jax
import jax.numpy as jnp

from qdenv.grid import NUM_MOVES
from qdenv.simulate.mapf.negotiated import rules

STRIDE = 11  # columns between the starts of neighbouring words
WORD = 32
COPIES = 3  # words that hold one cell


def words_per_row(width: int) -> int:
    """Count the words of one row of `width` cells."""
    return -(-width // STRIDE)


def pack(mask: jax.Array) -> jax.Array:
    """Pack a map of cells (bool [H', W']) into overlapping words (uint32 [H', words])."""
    width = mask.shape[1]
    columns = STRIDE * jnp.arange(words_per_row(width))[:, None] + jnp.arange(WORD)[None, :]
    bits = mask[:, jnp.minimum(columns, width - 1)] & (columns < width)[None]
    return (bits.astype(jnp.uint32) << jnp.arange(WORD, dtype=jnp.uint32)).sum(-1, dtype=jnp.uint32)


def empty(window: int, rows: int, width: int) -> jax.Array:
    """Make a table without reservations (uint32 [window * 5 * H' * words], flat)."""
    return jnp.zeros((window * NUM_MOVES * rows * words_per_row(width),), jnp.uint32)


def add_paths(
    table: jax.Array, paths: jax.Array, mask: jax.Array, shape: tuple[int, int], sign: int = 1
) -> jax.Array:
    """Add (or with ``sign=-1`` remove) the reservations of some paths.

    Args:
        table: from `empty`.
        paths: int32 [window + 1, K], positions of the padded grid.
        mask: bool [K], which of them.
        shape: (H', W').
        sign: 1 or -1.
    """
    rows, width = shape
    words = words_per_row(width)
    window = paths.shape[0] - 1
    plane = rules.move_plane(paths[1:] - paths[:-1], width)
    time = jnp.arange(window)[:, None]

    def updates(cells: jax.Array, plane: jax.Array, mask: jax.Array) -> tuple[jax.Array, jax.Array]:
        row, column = cells // width, cells % width
        base = ((time * NUM_MOVES + plane) * rows + row) * words
        places, values = [], []
        for copy in range(COPIES):
            word = column // STRIDE - copy
            bit = column - STRIDE * word
            seen = mask & (word >= 0) & (bit < WORD)
            places.append(base + jnp.maximum(word, 0))
            values.append(jnp.where(seen, jnp.uint32(1) << bit.astype(jnp.uint32) % WORD, 0))
        return jnp.stack(places), jnp.stack(values)

    mask = jnp.broadcast_to(mask, plane.shape)
    entered = updates(paths[1:], jnp.zeros_like(plane), mask)
    left = updates(paths[:-1], plane, mask & (plane > 0))
    places = jnp.concatenate([entered[0].reshape(-1), left[0].reshape(-1)])
    values = jnp.concatenate([entered[1].reshape(-1), left[1].reshape(-1)]).astype(jnp.uint32)
    values = values if sign > 0 else -values
    return table.at[places].add(values, mode="promise_in_bounds")


def around(packed: jax.Array, position: jax.Array, width: int, reach: int) -> jax.Array:
    """Cut the square of ``2 * reach + 1`` cells around every agent.

    Args:
        packed: uint32 [..., H', words].
        position: int32 [K].
        width: W'.
        reach: rows and columns to each side, at most 10.

    Returns:
        uint32 [..., 2 * reach + 1, K]: bit j of row i is the cell ``(i - reach, j - reach)`` away.
    """
    words = words_per_row(width)
    row, column = position // width, position % width - reach
    rows = row[None, :] - reach + jnp.arange(2 * reach + 1)[:, None]
    word, bit = column // STRIDE, (column % STRIDE).astype(jnp.uint32)
    flat = packed.reshape(*packed.shape[:-2], -1)
    seen = flat[..., rows * words + word[None, :]]
    return (seen >> bit) & jnp.uint32((1 << (2 * reach + 1)) - 1)
