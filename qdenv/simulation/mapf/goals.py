"""Task rules as data: where goals lie, and on which layouts a fleet can work."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Literal

import numpy as np

from qdenv.grid import by_tile, count_neighbours, of_tiles
from qdenv.lazy import ndimage
from qdenv.types import Array, Goal, InputError, TaskRule, to_array

GoalOdds = Literal["endpoints", "stations"]
_MOST_ODDS = 1e30  # of a cell: single precision holds the sum over a plan


def tile_goal(symbol: str, tiles: str, stay: int = 0) -> Goal:
    """Make every cell that holds `symbol`, of the alphabet `tiles`, a goal.

    Agents spend `stay` timesteps on the goal after arriving.
    """
    return Goal(
        lambda layout: of_tiles(layout, symbol, tiles).astype(np.float32), stay, f"{symbol!r}"
    )


def beside_goal(
    symbol: str, station: str, stay: int, tiles: str, odds: GoalOdds = "endpoints"
) -> Goal:
    """Make every `symbol` cell beside a `station` a goal.

    Both are symbols of the alphabet `tiles`. Agents spend `stay` timesteps on the goal after
    arriving. The goals are alike, or with the `odds` "stations" each counts once per station at its
    four sides.
    """

    def weight(layout: Array) -> Array:
        stations = count_neighbours(of_tiles(layout, station, tiles))
        alike = stations if odds == "stations" else stations > 0
        return (of_tiles(layout, symbol, tiles) * alike).astype(np.float32)

    return Goal(weight, stay, f"{symbol!r} beside {station!r}")


def station_goal(
    symbols: str, tiles: str, stays: Mapping[str, int], shares: Mapping[str, float]
) -> Goal:
    """Make the cells of several kinds of station one kind of goal.

    Agents spend ``stays[symbol]`` timesteps at a cell that holds the symbol. With `shares`, tasks
    go to the kinds in these proportions, and to all cells of a kind alike; without, to all cells.
    """
    table = np.array([stays.get(tile, 0) for tile in tiles], np.int32)

    def weight(layout: Array) -> Array:
        if not shares:
            return of_tiles(layout, symbols, tiles).astype(np.float32)
        odds: Array = np.zeros(layout.shape, np.float32)
        for symbol, share in shares.items():
            kind = of_tiles(layout, symbol, tiles).astype(np.float32)
            # A kind without a cell has no odds: its share goes to the others.
            odds = odds + np.float32(share) * kind / (kind.sum() + (kind.sum() == 0))
        return odds

    stay = table[[tiles.index(symbol) for symbol in symbols]]
    equal = int(stay[0]) if np.ptp(stay) == 0 else lambda layout: by_tile(table, layout)
    return Goal(weight, equal, "station")


def weigh(goal: Goal, rows: Sequence[str], shape: tuple[int, int]) -> Goal:
    """Make goals likelier by rows of numbers, one a cell of `shape`; as they are without rows.

    Raises InputError if the rows have another shape, a number is none, or negative, or all are 0.
    """
    if not rows:
        return goal
    lines = [row.split() for row in rows]
    widths = {len(line) for line in lines}
    if (len(lines), *widths) != shape:
        cols = " or ".join(map(str, sorted(widths)))
        size = "{} x {}".format(*shape)
        raise InputError(f"the demand has {len(lines)} x {cols} numbers, the plan {size} cells")
    exact = to_array(lines, float)  # empty where something is no number
    if not exact.size or not ((exact >= 0) & (exact <= _MOST_ODDS)).all():
        raise InputError(f"each number of the demand must be 0 or more, at most {_MOST_ODDS:g}")
    odds = exact.astype(np.float32)
    if not odds.any():
        raise InputError("the demand is 0 everywhere: no robot would have anything to do")
    return goal._replace(weight=lambda layout: odds * goal.weight(layout))


BY_SHELF = ("shelves",)  # in place of rows of numbers: demand belongs to shelves, not to places


def share_shelves(goal: Goal, shelf: str, tiles: str) -> Goal:
    """Give each `shelf` cell the same odds, divided equally among the goal's cells beside it."""

    def weight(layout: Array) -> Array:
        cells = goal.weight(layout) > 0
        # A twelfth of a shelf is the unit: whole numbers, whichever of 1 to 4 cells share it.
        parts = of_tiles(layout, shelf, tiles) * 12 // count_neighbours(cells).clip(1)
        return (cells * count_neighbours(parts)).astype(np.float32)

    return goal._replace(weight=weight)


def rows_of_odds(odds: np.ndarray) -> tuple[str, ...]:
    """Write odds of places (float [H, W]) as rows of numbers, which are hashable."""
    return tuple(" ".join(f"{one:g}" for one in row) for row in odds)


def check_playable(layout: np.ndarray, rule: TaskRule, agents: int) -> None:
    """Raise InputError for a layout (int8 [H, W]) on which the fleet could not work.

    It has fewer free cells than agents, a kind of goal has no cell, or some free cells cannot be
    reached from the others.
    """
    free = np.asarray(of_tiles(layout, rule.traversable, rule.tiles))
    if free.sum() < agents:
        there = f"the layout has {free.sum()}: simulate fewer agents"
        raise InputError(f"{agents} agents need as many free cells, {there}")
    for goal in rule.cycle:
        if not (np.asarray(goal.weight(layout)) > 0).any():
            shelves, drawn = (np.any(of_tiles(layout, one, rule.tiles)) for one in "@e")
            bare = goal.name == "endpoint" and shelves and not drawn
            advice = ": repair it with --keep @" if bare else ""
            none = f"the layout has no {goal.name} to drive to"
            raise InputError(f"robots have nothing to do: {none}{advice}")
    labels, parts = ndimage.label(free)
    if parts > 1:
        smallest = 1 + np.argmin(np.bincount(labels.ravel())[1:])
        row, column = np.argwhere(labels == smallest)[0]
        cut = f"row {row}, column {column} is cut off: repair the layout first"
        raise InputError(f"the free cells fall into {parts} parts, {cut}")


def task_odds(layout: np.ndarray, rule: TaskRule) -> np.ndarray:
    """Return the odds of each cell to be the start and the end of a task (float [L, 2, H, W]).

    A kind of task leads from one kind of goal to the next one; the way back from the last to the
    first is left out, as in the published guidance of warehouses (`highways`). Raises InputError
    for a layout (int8 [H, W]) on which no agent could work.
    """
    check_playable(layout, rule, 1)
    odds = [np.asarray(goal.weight(layout), float) for goal in rule.cycle]
    return np.array(list(pairwise(odds)) or [(odds[0], odds[0])])
