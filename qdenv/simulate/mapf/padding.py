"""Padding: the walls around a simulated grid, and positions on either side of them.

A layout of `cols` columns, surrounded by `margin` walls on each side, makes the padded grid that
planners see. Both number their cells ``row * width + column``, each with its own width.
"""

import jax
import jax.numpy as jnp

from qdenv.types import Array


def pad(positions: Array, cols: int, margin: int) -> jax.Array:
    """Translate positions of the layout into positions of the padded grid (any shape)."""
    row, column = jnp.divmod(positions, cols)
    return (row + margin) * (cols + 2 * margin) + column + margin


def unpad(positions: Array, cols: int, margin: int) -> jax.Array:
    """Translate positions of the padded grid into positions of the layout (any shape)."""
    row, column = jnp.divmod(positions, cols + 2 * margin)
    return (row - margin) * cols + column - margin


def unpad_grid(grid: Array, margin: int) -> jax.Array:
    """Cut the walls off a padded grid ([H', W'] -> [H, W])."""
    rows, cols = grid.shape
    return jnp.asarray(grid)[margin : rows - margin, margin : cols - margin]
