"""From the automaton's real-valued cells to a framed layout of tiles."""

from __future__ import annotations

import numpy as np

from qdenv.lazy import jax, jnp
from qdenv.types import Array


def choose_tiles(cells: Array) -> jax.Array:
    """Choose each cell's strongest channel (float32 [..., H, W, K] -> int8 [..., H, W])."""
    return jnp.argmax(cells, axis=-1).astype(jnp.int8)


def put_in_frame(tiles: Array, picture: np.ndarray, margin: tuple[int, int]) -> jax.Array:
    """Put generated tiles into the middle of a fixed frame.

    Args:
        tiles: int8 [H - 2 dr, W - 2 dc].
        picture: int8 [H, W], the frame; its inside is overwritten.
        margin: (dr, dc), what the frame adds to each side.

    Returns:
        int8 [H, W].
    """
    return jax.lax.dynamic_update_slice(jnp.asarray(picture), tiles.astype(jnp.int8), margin)


def inside_frame(layout: Array, margin: tuple[int, int]) -> Array:
    """Cut the generated area out of a framed layout, the inverse of `put_in_frame`."""
    rows, cols = layout.shape
    return layout[margin[0] : rows - margin[0], margin[1] : cols - margin[1]]
