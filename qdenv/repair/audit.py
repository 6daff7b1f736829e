"""Independent check of a layout against its rules: plain numpy and scipy, no solver."""

from typing import NamedTuple

import numpy as np

from qdenv.grid import count_neighbours
from qdenv.lazy import ndimage
from qdenv.types import Adjacency, Count, Rules


class Violation(NamedTuple):
    """One broken rule and a cell that breaks it."""

    message: str
    cell: tuple[int, int]  # (row, column)


def audit(layout: np.ndarray, rules: Rules) -> list[Violation]:
    """Name every rule that `layout` breaks.

    Args:
        layout: int8 [H, W].
        rules: the constraints.

    Returns:
        One `Violation` per broken rule, with the number of cells that break it and the first of
        them; empty when the layout is feasible.
    """
    layout = np.asarray(layout)
    shape = rules.allowed.shape[:2]
    if layout.shape != shape:
        return [Violation(f"the layout is {layout.shape}, its rules are for {shape}", (0, 0))]
    strange = (layout < 0) | (layout >= len(rules.tiles))
    if strange.any():
        return [_violation("tile outside the alphabet", strange)]
    checks = [
        *check_allowed(layout, rules),
        *(found for bound in rules.counts for found in _check_count(layout, rules.tiles, bound)),
        *(found for rule in rules.adjacency for found in _check_near(layout, rules.tiles, rule)),
    ]
    if rules.connected:
        driving = _holds(layout, rules.tiles, rules.connected)
        checks += _check_connected(driving, rules.connected)
        checks += _check_aisle(driving, rules.aisle)
    return checks


def check_allowed(layout: np.ndarray, rules: Rules) -> list[Violation]:
    """Name the first cell whose tile the rules do not allow there (fixed cells, keep-outs)."""
    rows, cols = np.indices(layout.shape)
    wrong = ~rules.allowed[rows, cols, layout]
    if not wrong.any():
        return []
    cell = tuple(np.argwhere(wrong)[0])
    allowed = "".join(np.array(list(rules.tiles))[rules.allowed[cell]])
    return [_violation(f"{rules.tiles[layout[cell]]!r} where only {allowed!r} may stand", wrong)]


def _holds(layout: np.ndarray, tiles: str, symbols: str) -> np.ndarray:
    """Mark the cells that hold one of `symbols` (bool [H, W])."""
    return np.isin(np.array(list(tiles))[layout], list(symbols))


def _violation(message: str, wrong: np.ndarray) -> Violation:
    """Describe the cells `wrong` (bool [H, W]) by their number and the first of them."""
    row, col = np.argwhere(wrong)[0]
    cells = "cell" if wrong.sum() == 1 else "cells"
    return Violation(f"{message} ({wrong.sum()} {cells})", (int(row), int(col)))


def _check_count(layout: np.ndarray, tiles: str, bound: Count) -> list[Violation]:
    """Compare a number of tiles with its bounds."""
    holds = _holds(layout, tiles, bound.tiles)
    count, high = int(holds.sum()), bound.high
    if bound.low <= count and (high is None or count <= high):
        return []
    if bound.low == high:
        wanted = f"exactly {high}"
    elif high is None:
        wanted = f"at least {bound.low}"
    else:
        wanted = f"{bound.low} to {high}"
    cell = np.argwhere(holds if count else np.ones_like(holds))[0]
    message = f"{count} tiles {bound.tiles!r} where the rules ask for {wanted}"
    return [Violation(message, (int(cell[0]), int(cell[1])))]


def _check_near(layout: np.ndarray, tiles: str, rule: Adjacency) -> list[Violation]:
    """Find tiles without the 4-neighbour they need."""
    near = count_neighbours(_holds(layout, tiles, rule.needs)) > 0
    wrong = _holds(layout, tiles, rule.tiles) & ~near
    if not wrong.any():
        return []
    return [_violation(f"{rule.tiles!r} without a neighbour of {rule.needs!r}", wrong)]


def _check_connected(driving: np.ndarray, symbols: str) -> list[Violation]:
    """Find cells cut off from the largest part of a group that must hang together."""
    labels, parts = ndimage.label(driving)
    if parts <= 1:
        return []
    largest = 1 + np.argmax(np.bincount(labels.ravel())[1:])
    cut_off = driving & (labels != largest)
    return [_violation(f"{symbols!r} in {parts} unconnected parts, cut off", cut_off)]


def _check_aisle(driving: np.ndarray, aisle: int) -> list[Violation]:
    """Find driving cells in passages narrower than `aisle`."""
    if aisle <= 1:
        return []
    # An opening keeps exactly the cells covered by a fitting square.
    wide = ndimage.binary_opening(driving, np.ones((aisle, aisle), bool))
    narrow = driving & ~wide
    return [_violation(f"passage narrower than {aisle}", narrow)] if narrow.any() else []
