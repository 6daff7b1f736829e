"""A regular layout that obeys the rules by construction: where annealing starts as a last resort.

Lanes with two rows of obstacles between them: every obstacle touches a lane, so any of them may be
left out, and about two thirds of the cells can be obstacles, which no connected layout exceeds.
"""

import numpy as np

from qdenv.grid import MOVES
from qdenv.types import Rules


def templates(layout: np.ndarray, rules: Rules) -> list[np.ndarray]:
    """Draw lanes along rows and along columns, in every phase (each int8 [H, W]).

    Args:
        layout: int8 [H, W], the input: obstacles stand where it has some, as far as they fit.
        rules: the constraints.

    Returns:
        Candidates; fixed cells and odd keep-outs may still break a rule here and there.
    """
    height, width = layout.shape
    period = rules.aisle + 2
    rows, cols = np.indices((height, width))
    drawn = []
    for along, across, last in ((rows, cols, width), (cols, rows, height)):
        spine = (across < rules.aisle) | (across >= last - rules.aisle)
        drawn += [
            _furnish(layout, rules, ((along + phase) % period < rules.aisle) | spine)
            for phase in range(period)
        ]
        drawn += [
            _furnish(layout, rules, (along + phase) % period < rules.aisle)
            for phase in range(period)
        ]
    return drawn


def _furnish(layout: np.ndarray, rules: Rules, lanes: np.ndarray) -> np.ndarray:
    """Drive everywhere, then put the obstacles that the counts ask for beside the lanes."""
    drives = np.array([tile in rules.connected for tile in rules.tiles])
    demands = np.array(
        [sum(tile in rule.tiles for rule in rules.adjacency) for tile in rules.tiles]
    )
    # The least demanding driving tile that is allowed, else any allowed tile.
    worth = rules.allowed * (1.0 + drives * 100.0 - demands)
    drawn = worth.argmax(-1).astype(np.int8)
    for bound in rules.counts:
        wanted = np.array(
            [tile in bound.tiles and not drives[k] for k, tile in enumerate(rules.tiles)]
        )
        may = (rules.allowed & wanted).any(-1) & ~lanes
        missing = bound.low - int(np.isin(drawn, np.flatnonzero(wanted)).sum())
        for row, col in _nearest_first(may & drives[drawn], wanted[layout]):
            if missing <= 0:
                break
            home = layout[row, col]
            kind = home if wanted[home] else int(np.argmax(rules.allowed[row, col] & wanted))
            drawn[row, col] = kind if rules.allowed[row, col, kind] else drawn[row, col]
            _serve(drawn, rules, row, col, lanes)
            missing -= 1
    return drawn


def _nearest_first(may: np.ndarray, alike: np.ndarray) -> np.ndarray:
    """List the cells of `may` (bool [H, W]), those of `alike` first (int64 [cells, 2])."""
    cells = np.argwhere(may)
    return cells[np.argsort(~alike[may], kind="stable")]


def _serve(drawn: np.ndarray, rules: Rules, row: int, col: int, lanes: np.ndarray) -> None:
    """Give the tile at a cell the neighbour on a lane that each of its demands asks for."""
    tiles = rules.tiles
    around = [(row + down, col + right) for down, right in MOVES]
    around = [(r, c) for r, c in around if 0 <= r < drawn.shape[0] and 0 <= c < drawn.shape[1]]
    for rule in rules.adjacency:
        if tiles[drawn[row, col]] not in rule.tiles:
            continue
        if any(tiles[drawn[cell]] in rule.needs for cell in around):
            continue
        for cell in sorted(around, key=lambda cell: not lanes[cell]):
            fits = [
                k for k, tile in enumerate(tiles) if tile in rule.needs and tile in rules.connected
            ]
            fits = [kind for kind in fits if rules.allowed[cell][kind]]
            if fits and tiles[drawn[cell]] in rules.connected:
                drawn[cell] = fits[0]
                break
