"""Independent check of a layout against its rules: plain numpy and scipy, no solver."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from qdenv.grid import of_tiles, shift
from qdenv.lazy import ndimage
from qdenv.types import Rules


class Violation(NamedTuple):
    """One broken rule."""

    message: str  # which rule, in words; where cells break it, their number and the first
    cells: np.ndarray  # int64 [n, 2], (row, column) of the cells that break it


def audit(layout: np.ndarray, rules: Rules) -> list[Violation]:
    """Name every rule that a layout (int8 [H, W]) breaks, with the cells that do.

    A `layout` of another size than the `rules` are for breaks one; a feasible one breaks none.
    """
    layout = np.asarray(layout)
    shape = rules.allowed.shape[:2]
    if layout.shape != shape:
        sizes = "the layout has {} x {} cells, its rules are for {} x {}".format(
            *layout.shape, *shape
        )
        return [Violation(sizes, np.zeros((1, 2), np.int64))]
    strange = (layout < 0) | (layout >= len(rules.tiles))
    if strange.any():
        return _violations("tile outside the alphabet", strange)
    found = check_allowed(layout, rules)
    for tiles, low, high in rules.counts:
        holds = of_tiles(layout, tiles, rules.tiles)
        count = int(holds.sum())
        if low <= count and (high is None or count <= high):
            continue
        demand = f"at least {low}" if high is None else f"{low} to {high}"
        demand = f"exactly {high}" if low == high else demand
        message = f"{count} {rules.name(tiles, count != 1)} where the rules demand {demand}"
        found.append(Violation(message, np.argwhere(holds if count else ~holds)))
    for tiles, needs in rules.adjacency:
        there = np.asarray(of_tiles(layout, needs, rules.tiles), np.int8)
        near = ndimage.correlate(there, [[0, 1, 0], [1, 0, 1], [0, 1, 0]], mode="constant") > 0
        alone = np.asarray(of_tiles(layout, tiles, rules.tiles) & ~near)
        found += _violations(f"{rules.name(tiles)} without {rules.name(needs)} beside it", alone)
    driving = of_tiles(layout, rules.connected, rules.tiles)
    labels, parts = ndimage.label(driving)
    if parts > 1:
        largest = 1 + np.argmax(np.bincount(labels.ravel())[1:])
        message = f"the driving area is in {parts} unconnected parts, cut off"
        found += _violations(message, driving & (labels != largest))
    return found + [one for _, broken in check_built(layout, rules) for one in broken]


def check_built(layout: np.ndarray, rules: Rules) -> Iterator[tuple[str, list[Violation]]]:
    """Yield each rule on aisles and racks, in words, with what breaks it."""
    for tiles, shapes, ends in rules.covers:
        holds = np.asarray(of_tiles(layout, tiles, rules.tiles))
        may = rules.allowed[..., [tile in tiles for tile in rules.tiles]]
        # An opening keeps exactly the cells covered by a fitting rectangle.
        covered, room = (
            np.any([ndimage.binary_opening(cells, np.ones(shape, bool)) for shape in shapes], 0)
            for cells in (holds, may.any(-1))
        )
        (rows, cols), fixed = shapes[0], may.sum(-1) == rules.allowed.sum(-1)
        if set(tiles) == set(rules.connected):
            message = f"aisle narrower than {rows} cells"
            yield f"aisles {rows} cells wide", _violations(message, holds & ~covered & room)
            continue
        rack = f"rack of {rows} x {cols}"
        if ends:
            covered = _between(holds, np.asarray(of_tiles(layout, ends, rules.tiles)))
            rack = "rack with aisles on both sides"
        noun = rules.name(tiles)
        broken = _violations(f"{noun} in no {rack}", holds & ~covered & ~fixed)
        yield f"every {noun} in a {rack}", broken
    if rules.straight:
        tiles, most = rules.straight
        holds, wrong = np.asarray(of_tiles(layout, tiles, rules.tiles)), list[Violation]()
        for axis, lines in ((1, "rows"), (0, "columns")):
            labels, _ = ndimage.label(holds.any(axis))
            long = (labels > 0) & (np.bincount(labels)[labels] > most)
            many = rules.name(tiles, True)
            message = f"{many} in {most + 1} or more {lines} without a straight aisle"
            wrong += _violations(message, holds & (long[:, None] if axis else long))
        yield f"a straight aisle among any {most + 1} successive rows or columns", wrong


def _between(holds: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Find cells in runs of one or two, along a row or column, between `ends` (all bool [H, W])."""
    found = np.zeros_like(holds)
    for down, right in ((1, 0), (0, 1)):
        along = np.zeros((3, 3), bool)
        along[1 - down : 2 + down, 1 - right : 2 + right] = True
        runs, _ = ndimage.label(holds, along)
        open_ends = 1 * shift(ends, (down, right)) + shift(ends, (-down, -right))
        sizes, beside = np.bincount(runs.ravel()), np.bincount(runs.ravel(), open_ends.ravel())
        found |= ((sizes <= 2) & (beside == 2))[runs]
    return found


def check_allowed(layout: np.ndarray, rules: Rules) -> list[Violation]:
    """Find the cells whose tile the rules do not allow there (fixed cells, keep-outs)."""
    rows, cols = np.indices(layout.shape)
    wrong = ~rules.allowed[rows, cols, layout]
    if not wrong.any():
        return []
    # One violation, with a part for each pair of a tile and what may stand there instead.
    cells = np.argwhere(wrong)
    pairs = np.column_stack([layout[wrong], rules.allowed[wrong]])
    kinds, first, counts = np.unique(pairs, axis=0, return_index=True, return_counts=True)
    parts = []
    for part in np.argsort(first):
        tile, allowed = rules.tiles[kinds[part, 0]], kinds[part, 1:].astype(bool)
        instead = "".join(np.array(list(rules.tiles))[allowed])
        message = f"{rules.name(tile)} where only {rules.name(instead, True)} may stand"
        parts.append(_located(message, counts[part], cells[first[part]]))
    return [Violation("; ".join(parts), cells)]


def _violations(message: str, wrong: np.ndarray) -> list[Violation]:
    """Describe the cells `wrong` (bool [H, W]), if any, by their number and the first of them."""
    cells = np.argwhere(wrong)
    return [Violation(_located(message, len(cells), cells[0]), cells)] if len(cells) else []


def _located(message: str, count: int, first: np.ndarray) -> str:
    """Add the number of cells, and the first (row, column), to a message."""
    row, column = first.tolist()
    cells = "1 cell," if count == 1 else f"{count} cells, the first at"
    return f"{message}: {cells} row {row}, column {column}"
