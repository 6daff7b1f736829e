"""Independent check of a layout against its rules: plain numpy and scipy, no solver."""

from typing import NamedTuple

import numpy as np

from qdenv.grid import count_neighbours, of_tiles
from qdenv.lazy import ndimage
from qdenv.types import Rules


class Violation(NamedTuple):
    """One broken rule and a cell that breaks it."""

    message: str
    cell: tuple[int, int]  # (row, column)


def audit(layout: np.ndarray, rules: Rules) -> list[Violation]:
    """Name every rule that `layout` (int8 [H, W]) breaks, with the number of cells that do."""
    layout = np.asarray(layout)
    shape = rules.allowed.shape[:2]
    if layout.shape != shape:
        return [Violation(f"the layout is {layout.shape}, its rules are for {shape}", (0, 0))]
    strange = (layout < 0) | (layout >= len(rules.tiles))
    if strange.any():
        return _violations("tile outside the alphabet", strange)
    found = check_allowed(layout, rules)
    for tiles, low, high in rules.counts:
        holds = of_tiles(layout, tiles, rules.tiles)
        count = int(holds.sum())
        if low <= count and (high is None or count <= high):
            continue
        wanted = f"at least {low}" if high is None else f"{low} to {high}"
        wanted = f"exactly {high}" if low == high else wanted
        row, col = np.argwhere(holds if count else np.ones_like(holds))[0]
        message = f"{count} tiles {tiles!r} where the rules ask for {wanted}"
        found.append(Violation(message, (int(row), int(col))))
    for tiles, needs in rules.adjacency:
        near = count_neighbours(of_tiles(layout, needs, rules.tiles)) > 0
        alone = np.asarray(of_tiles(layout, tiles, rules.tiles) & ~near)
        found += _violations(f"{tiles!r} without a neighbour of {needs!r}", alone)
    if not rules.connected:
        return found
    driving = of_tiles(layout, rules.connected, rules.tiles)
    labels, parts = ndimage.label(driving)
    if parts > 1:
        largest = 1 + np.argmax(np.bincount(labels.ravel())[1:])
        message = f"{rules.connected!r} in {parts} unconnected parts, cut off"
        found += _violations(message, driving & (labels != largest))
    if rules.aisle > 1:
        # An opening keeps exactly the cells covered by a fitting square.
        wide = ndimage.binary_opening(driving, np.ones((rules.aisle, rules.aisle), bool))
        found += _violations(f"passage narrower than {rules.aisle}", driving & ~wide)
    return found


def check_allowed(layout: np.ndarray, rules: Rules) -> list[Violation]:
    """Name the first cell whose tile the rules do not allow there (fixed cells, keep-outs)."""
    rows, cols = np.indices(layout.shape)
    wrong = ~rules.allowed[rows, cols, layout]
    if not wrong.any():
        return []
    row, col = np.argwhere(wrong)[0]
    allowed = "".join(np.array(list(rules.tiles))[rules.allowed[row, col]])
    tile = rules.tiles[layout[row, col]]
    return _violations(f"{tile!r} where only {allowed!r} may stand", wrong)


def _violations(message: str, wrong: np.ndarray) -> list[Violation]:
    """Describe the cells `wrong` (bool [H, W]), if any, by their number and the first of them."""
    if not wrong.any():
        return []
    row, col = np.argwhere(wrong)[0]
    cells = "cell" if wrong.sum() == 1 else "cells"
    return [Violation(f"{message} ({wrong.sum()} {cells})", (int(row), int(col)))]
