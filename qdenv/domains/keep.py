"""Locked cells, whose tiles are drawn by hand: doors, stations, aisles, keep-outs.

A keep drawing has the shape of the layout: in each cell the tile that it must hold, or ``?`` for
any. Beside a plan, ``!`` stands for the tile that the plan has there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from qdenv.types import InputError

FREE, SAME = "?", "!"


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
    codes = {FREE: -1} | {symbol: kind for kind, symbol in enumerate(tiles)}
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
