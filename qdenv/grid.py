"""The grid: moves, neighbours, and text to tiles and back.

A position is ``row * width + column``. The four moves are right, left, down, up, in this order.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np

from qdenv.lazy import jax, jnp
from qdenv.types import Array, InputError

MOVES = ((0, 1), (0, -1), (1, 0), (-1, 0))  # (row, column) steps: right, left, down, up
# Where waiting counts as a move it is number 0, for planners try it first.
WAIT, RIGHT, LEFT, DOWN, UP = range(1 + len(MOVES))
NUM_MOVES = 1 + len(MOVES)
Cells = TypeVar("Cells", "jax.Array", np.ndarray)  # positions
_RECTANGLE = re.compile(r"(\d{0,9}):(\d{0,9}),(\d{0,9}):(\d{0,9})")


def checksum(layout: np.ndarray) -> str:
    """Return eight digits that tell a layout (int [H, W]) from others of its size."""
    return f"{zlib.crc32(np.asarray(layout, np.int8).tobytes()):08x}"


def move_steps(width: int) -> np.ndarray:
    """List what each move adds to a position on a grid of `width` columns (int [5], wait first)."""
    return np.array([0, *(row * width + column for row, column in MOVES)])


def _library_of(values: Array) -> Any:
    # Numpy for its own arrays: to check a layout, no compiler is imported.
    return np if isinstance(values, np.ndarray) else jnp


def shift(values: Array, move: tuple[int, int], fill: object = 0) -> Array:
    """Look a move away in [H, W, ...]: result[r, c] = values[r + dr, c + dc], `fill` outside."""
    rows, cols = values.shape[:2]
    edges = [(1, 1)] * 2 + [(0, 0)] * (values.ndim - 2)
    padded = _library_of(values).pad(values, edges, constant_values=fill)
    return padded[1 + move[0] : 1 + move[0] + rows, 1 + move[1] : 1 + move[1] + cols]


def count_neighbours(mask: Array) -> Array:
    """Count each cell's 4-neighbours inside `mask` (bool [H, W] -> int32 [H, W])."""
    right, left, down, up = (shift(mask.astype(np.int32), move) for move in MOVES)
    return right + left + down + up


def fixed_point(change: Callable[[jax.Array], jax.Array], values: jax.Array) -> jax.Array:
    """Apply `change` until no value (number or bool, never NaN) changes; traceable."""
    return jax.lax.while_loop(
        lambda state: state[1],
        lambda state: (after := change(state[0]), (after != state[0]).any()),
        (values, jnp.array(True)),
    )[0]


def inside_frame(layout: Array, margin: tuple[int, int]) -> Array:
    """Cut the generated area out of a layout whose frame adds (rows, columns) to each side."""
    rows, cols = layout.shape[:2]
    return layout[margin[0] : rows - margin[0], margin[1] : cols - margin[1]]


def pad(positions: Cells, cols: int, margin: int) -> Cells:
    """Translate positions of a layout of `cols` columns into those with a margin (any shape).

    With the columns of the padded layout, a negative margin takes it off again.
    """
    row, column = positions // cols, positions % cols
    return (row + margin) * (cols + 2 * margin) + column + margin


def parse(rows: Sequence[str], tiles: str, known: str = "") -> np.ndarray:
    """Turn H rows of W symbols into a layout (int8 [H, W]); symbol ``tiles[k]`` is tile ``k``.

    Raises InputError if the drawing is empty or ragged, or holds a symbol outside the alphabet,
    which the message lists as `known`, like "this domain knows '.'".
    """
    if not rows or not rows[0]:
        raise InputError("the layout is empty: give at least one row of tiles")
    width = len(rows[0])
    for index, row in enumerate(rows):
        if len(row) != width:
            longer = f"row {index} of the layout has {len(row)} tiles, row 0 has {width}"
            raise InputError(f"{longer}: make all rows equally long")
        for column, symbol in enumerate(row):
            if symbol not in tiles:
                known = known or f"this domain knows {' '.join(map(repr, tiles))}"
                raise InputError(
                    f"unknown tile {symbol!r} at row {index}, column {column}: {known}"
                )
    return np.array([[tiles.index(symbol) for symbol in row] for row in rows], dtype=np.int8)


def draw(layout: Array, tiles: str) -> list[str]:
    """Draw a layout (int8 [H, W]) as H strings, the inverse of `parse`."""
    return ["".join(tiles[tile] for tile in row) for row in np.asarray(layout)]


def rectangle(text: str, shape: tuple[int, ...]) -> tuple[slice, slice] | None:
    """Read ``ROWS,COLUMNS``, each FIRST:END with END left out; a missing end is that of the grid.

    None if the text is no such rectangle. Raises InputError if it is not within the grid's `shape`.
    """
    found = _RECTANGLE.fullmatch(text)
    if not found:
        return None
    whole = 0, shape[0], 0, shape[1]
    ends = [int(one or usual) for one, usual in zip(found.groups(), whole, strict=True)]
    top, bottom, left, right = ends
    if not (top < bottom <= shape[0] and left < right <= shape[1]):
        form = f"rows FIRST:END up to {shape[0]} and columns up to {shape[1]}"
        raise InputError(f"{text}: {form}, counted from 0, the end left out")
    return slice(top, bottom), slice(left, right)


def by_tile(table: np.ndarray, layout: Array) -> Array:
    """Give each cell of `layout` (int8 [H, W]) the entry of its tile in a table of all tiles."""
    return _library_of(layout).asarray(table)[layout.astype(np.int32)]


def of_tiles(layout: Array, symbols: str, tiles: str) -> Array:
    """Mark the cells of `layout` that hold one of `symbols` (int8 [H, W] -> bool [H, W])."""
    return by_tile(np.array([tile in symbols for tile in tiles]), layout)
