"""Padding: the walls around a simulated grid, and positions on either side of them.

A layout of `cols` columns, surrounded by `margin` walls on each side, makes the padded grid that
planners see. Both number their cells ``row * width + column``, each with its own width.
"""

from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from qdenv.native import shared
from qdenv.types import Array

Cells = TypeVar("Cells", int, jax.Array, np.ndarray)


@shared
def pad(positions: Cells, cols: int, margin: int) -> Cells:
    """Translate positions of the layout into positions of the padded grid (any shape)."""
    row, column = positions // cols, positions % cols
    return (row + margin) * (cols + 2 * margin) + column + margin


@shared
def unpad(positions: Cells, cols: int, margin: int) -> Cells:
    """Translate positions of the padded grid into positions of the layout (any shape)."""
    row, column = positions // (cols + 2 * margin), positions % (cols + 2 * margin)
    return (row - margin) * cols + column - margin


def unpad_grid(grid: Array, margin: int) -> jax.Array:
    """Cut the walls off a padded grid ([H', W'] -> [H, W])."""
    rows, cols = grid.shape
    return jnp.asarray(grid)[margin : rows - margin, margin : cols - margin]
