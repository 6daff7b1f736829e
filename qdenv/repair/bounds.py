"""What counting alone shows: rules no layout can obey, and a lower bound on the price."""

import numpy as np
from scipy import ndimage

from qdenv.types import Rules

CROSS = ndimage.generate_binary_structure(2, 1)


def _capacity(rules: Rules, tiles: str) -> tuple[int, int]:
    """Count the cells that must, and those that may, hold one of `tiles`."""
    inside = np.array([tile in tiles for tile in rules.tiles])
    may = (rules.allowed & inside).any(-1)
    must = may & ~(rules.allowed & ~inside).any(-1)
    return int(must.sum()), int(may.sum())


def impossible(rules: Rules) -> str | None:
    """Name a contradiction in `rules` that counting shows, or return None.

    None is no proof that a layout exists.
    """
    if not rules.allowed.any(-1).all():
        row, col = np.argwhere(~rules.allowed.any(-1))[0]
        return f"no tile may stand at row {row}, column {col}"
    for bound in rules.counts:
        must, may = _capacity(rules, bound.tiles)
        high = may if bound.high is None else bound.high
        if bound.low > high:
            return f"{bound.tiles!r} is asked for at least {bound.low} and at most {high} times"
        if bound.low > may:
            return f"{bound.low} {bound.tiles!r} are asked for but only {may} cells may hold one"
        if high < must:
            return f"at most {high} {bound.tiles!r} are allowed but {must} cells must hold one"
        most = _served(rules, bound.tiles)
        if bound.low > most:
            return (
                f"{bound.low} {bound.tiles!r} are asked for but a connected driving area "
                f"can reach at most {most}"
            )
    return _cut_apart(rules)


def _served(rules: Rules, tiles: str) -> int:
    """Bound how many obstacles `tiles` a connected driving area can serve.

    A part of c serving cells that hangs together has 4c sides and spends 2 (c - 1) of them on
    itself, and one more where something else joins it to the other parts: each part serves at
    most 2c + 1 obstacles (2c + 2 when it is alone).
    """
    needs = [rule.needs for rule in rules.adjacency if set(tiles) <= set(rule.tiles)]
    needs = [need for need in needs if set(need) <= set(rules.connected)]
    if not needs or set(tiles) & set(rules.connected):
        return rules.allowed[..., 0].size
    serves, holds, drives = (_may(rules, group) for group in (needs[0], tiles, rules.connected))
    joints = serves & ndimage.binary_dilation(drives & ~serves, CROSS)
    parts = max(2, int(joints.sum()))
    return int(2 * (serves.sum() + (holds & ~serves).sum()) + parts) // 3


def _cut_apart(rules: Rules) -> str | None:
    """Name a fixed driving cell that fixed obstacles cut off from another one."""
    drives = _may(rules, rules.connected)
    others = "".join(set(rules.tiles) - set(rules.connected))
    always = drives & ~_may(rules, others)
    labels, _ = ndimage.label(drives, CROSS)
    parts = np.unique(labels[always])
    if not rules.connected or parts.size <= 1:
        return None
    row, col = np.argwhere(always & (labels == parts[1]))[0]
    return f"fixed obstacles cut row {row}, column {col} off from the rest of {rules.connected!r}"


def _may(rules: Rules, tiles: str) -> np.ndarray:
    """Mark the cells that may hold one of `tiles` (bool [H, W])."""
    return (rules.allowed & np.array([tile in tiles for tile in rules.tiles])).any(-1)


def price_bound(layout: np.ndarray, rules: Rules) -> float:
    """Bound the repair's price from below by the counts alone."""
    best = 0.0
    for bound in rules.counts:
        holds = np.isin(np.array(list(rules.tiles))[layout], list(bound.tiles))
        count = int(holds.sum())
        if count < bound.low:
            best = max(best, np.sort(rules.change_cost[~holds])[: bound.low - count].sum())
        elif bound.high is not None and count > bound.high:
            best = max(best, np.sort(rules.change_cost[holds])[: count - bound.high].sum())
    return float(best)
