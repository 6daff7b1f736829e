"""Task rules as data: where goals lie, and on which layouts a fleet can work."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from qdenv.grid import count_neighbours, of_tiles
from qdenv.lazy import ndimage
from qdenv.types import Goal, InputError, TaskRule


def tile_goal(symbol: str, tiles: str, stay: int = 0) -> Goal:
    """Make every cell that holds `symbol` a goal, with a `stay` of timesteps after arriving."""
    return Goal(
        lambda layout: of_tiles(layout, symbol, tiles).astype(np.float32), stay, f"{symbol!r}"
    )


def beside_goal(symbol: str, station: str, stay: int, tiles: str) -> Goal:
    """Make every `symbol` cell beside a `station` a goal, once per station at its four sides.

    Agents spend `stay` timesteps on the goal after arriving.
    """
    return Goal(
        lambda layout: (
            of_tiles(layout, symbol, tiles) * count_neighbours(of_tiles(layout, station, tiles))
        ).astype(np.float32),
        stay,
        f"{symbol!r} beside {station!r}",
    )


def favour_left(goal: Goal, odds: float) -> Goal:
    """Make goals in column 0 `odds` times likelier (uneven warehouse of appendix B.1: 5)."""
    return goal._replace(
        weight=lambda layout: (
            np.where(np.arange(layout.shape[1])[None] == 0, np.float32(odds), np.float32(1))
            * goal.weight(layout)
        )
    )


def check_playable(layout: np.ndarray, rule: TaskRule, agents: int) -> None:
    """Raise InputError for a layout (int8 [H, W]) on which the fleet could not work.

    It has fewer free cells than agents, a kind of goal has no cell, or some free cells cannot be
    reached from the others.
    """
    free = np.asarray(of_tiles(layout, rule.traversable, rule.tiles))
    if free.sum() < agents:
        raise InputError(
            f"{agents} agents need as many free cells, the layout has {free.sum()}: "
            "simulate fewer agents"
        )
    for goal in rule.cycle:
        if not (np.asarray(goal.weight(layout)) > 0).any():
            raise InputError(f"no agent could work: the layout has no {goal.name}")
    labels, parts = ndimage.label(free)
    if parts > 1:
        smallest = 1 + np.argmin(np.bincount(labels.ravel())[1:])
        row, column = np.argwhere(labels == smallest)[0]
        raise InputError(
            f"the free cells fall into {parts} parts, row {row}, column {column} is cut off: "
            "repair the layout first"
        )


def task_odds(layout: np.ndarray, rule: TaskRule) -> np.ndarray:
    """Return the odds of each cell to be the start and the end of a task (float [L, 2, H, W]).

    A kind of task leads from one kind of goal to the next one; the way back from the last to the
    first is left out, as in the published guidance of warehouses (`highways`). Raises InputError
    for a layout (int8 [H, W]) on which no agent could work.
    """
    check_playable(layout, rule, 1)
    odds = [np.asarray(goal.weight(layout), float) for goal in rule.cycle]
    return np.array(list(pairwise(odds)) or [(odds[0], odds[0])])
