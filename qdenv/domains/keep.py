"""Cells that stay as somebody drew them: doors, stations, aisles, keep-outs.

A keep drawing has the shape of the layout and says of each cell what it must hold: a tile, or
``?`` for whatever is best. Beside a plan, ``!`` is the tile that the plan holds there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from qdenv.lazy import jax, jnp
from qdenv.types import Array, InputError, Rules

FREE, SAME = "?", "!"
NOTHING = -1  # in place of a tile: nothing is kept


def kept_tiles(keep: Sequence[str], tiles: str, shape: tuple[int, int]) -> np.ndarray:
    """Read a keep drawing whose cells all name their tile.

    Args:
        keep: its rows, out of `tiles` and ``?``.
        tiles: the alphabet.
        shape: rows and columns of the layouts.

    Returns:
        int8 [H, W], the tile that each cell must hold, -1 for any.

    Raises:
        InputError: the drawing has another shape, or a cell names no tile.
    """
    check_shape(keep, shape)
    codes = {FREE: NOTHING} | {symbol: kind for kind, symbol in enumerate(tiles)}
    for index, row in enumerate(keep):
        for column, symbol in enumerate(row):
            if symbol not in codes:
                raise InputError(
                    f"row {index}, column {column} of the cells to keep is {symbol!r}: "
                    f"draw {FREE!r} or one of {' '.join(map(repr, tiles))}"
                )
    return np.array([[codes[symbol] for symbol in row] for row in keep], np.int8)


def check_shape(keep: Sequence[str], shape: tuple[int, int]) -> None:
    """Refuse a keep drawing that is not of the layouts' shape.

    Raises:
        InputError: it has another one, or none.
    """
    rows, cols = len(keep), max(map(len, keep), default=0)
    if (rows, cols) != shape or any(len(row) != cols for row in keep):
        raise InputError(
            f"the cells to keep are drawn on {rows} x {cols}, the layout has "
            f"{shape[0]} x {shape[1]}: draw them on the same shape, or ask for this one"
        )


def keep_in_rules(rules: Rules, kept: np.ndarray) -> Rules:
    """Demand of the rules that cells hold the tiles of `kept` (int8 [H, W], -1 for any)."""
    only = np.eye(len(rules.tiles), dtype=bool)[kept]
    return rules._replace(allowed=np.where((kept >= 0)[..., None], only, rules.allowed))


def keep_in_frame(
    frame: Callable[[Array], Array], kept: np.ndarray
) -> Callable[[Array], jax.Array]:
    """Stamp the tiles of `kept` (int8 [H, W], -1 for any) onto whatever a frame is put around."""

    def framed(area: Array) -> jax.Array:
        return jnp.where(kept >= 0, kept, frame(area))

    return framed
