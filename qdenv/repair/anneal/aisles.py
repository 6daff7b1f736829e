"""Wide aisles: which driving cells an open square covers. Compiled by numba, where rules ask."""

import numpy as np

from qdenv.native import formula, kernel
from qdenv.repair.anneal.state import Aisles, Board, Trait


@formula
def _toggle(board: Board, aisles: Aisles, cell: int, opens: int) -> int:
    """Open or close a cell; returns the change in driving cells that no open square covers."""
    side, driving, closed, cover = aisles
    stride, broken = board.steps[4], -(driving[cell] == 1 and cover[cell] == 0)
    driving[cell] = opens
    broken += driving[cell] == 1 and cover[cell] == 0
    for corner_step in range(side * side):
        corner = cell - corner_step // side * stride - corner_step % side
        if corner < 0:
            continue
        before = closed[corner] == 0
        closed[corner] += -1 if opens else 1
        after = closed[corner] == 0
        # Only a square that opens or closes as a whole changes what its cells are covered by.
        if before == after:
            continue
        for inside_step in range(side * side):
            inside = corner + inside_step // side * stride + inside_step % side
            broken -= driving[inside] == 1 and cover[inside] == 0
            cover[inside] += 1 if after else -1
            broken += driving[inside] == 1 and cover[inside] == 0
    return broken


@kernel
def set_aisles(
    board: Board, aisles: Aisles, cells: np.ndarray, tiles: np.ndarray, changes: int
) -> int:
    """Bring the aisles to `tiles` on `cells`; returns the change in broken demands."""
    broken = 0
    for index in range(changes):
        cell, opens = cells[index], board.traits[tiles[index], Trait.DRIVES]
        if aisles.driving[cell] != opens:
            broken += _toggle(board, aisles, cell, opens)
    return broken
