"""What counting alone shows: rules no layout can obey, and a lower bound on the cost."""

import numpy as np

from qdenv.lazy import ndimage
from qdenv.repair.facts import Facts
from qdenv.types import Rules

CROSS = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], bool)
BESIDE = CROSS & ~np.pad([[True]], 1)


def impossible(rules: Rules) -> str | None:
    """Name a contradiction in `rules` that counting shows, or return None.

    None is no proof that a layout exists.
    """
    return find_contradiction(Facts(rules))


def find_contradiction(facts: Facts) -> str | None:
    """Name a contradiction as `impossible` does, from what is known of the rules already."""
    rules = facts.rules
    if not rules.allowed.any(-1).all():
        row, col = np.argwhere(~rules.allowed.any(-1))[0]
        return f"no tile may stand at row {row}, column {col}"
    for bound in rules.counts:
        must, may = int(facts.must(bound.tiles).sum()), int(facts.may(bound.tiles).sum())
        high = may if bound.high is None else bound.high
        if bound.low > high:
            return f"{bound.tiles!r} is asked for at least {bound.low} and at most {high} times"
        if bound.low > may:
            return f"{bound.low} {bound.tiles!r} are asked for but only {may} cells may hold one"
        if high < must:
            return f"at most {high} {bound.tiles!r} are allowed but {must} cells must hold one"
        most = _count_servable(facts, bound.tiles)
        if bound.low > most:
            return (
                f"{bound.low} {bound.tiles!r} are asked for but a connected driving area "
                f"can reach at most {most}"
            )
    return _find_unserved(facts) or _find_cut_off(facts)


def _count_servable(facts: Facts, tiles: str) -> int:
    """Bound how many obstacles `tiles` a connected driving area can serve.

    A part of c serving cells that hangs together has 4c sides and spends 2 (c - 1) of them on
    itself, and one more where something else joins it to the other parts: each part serves at
    most 2c + 1 obstacles (2c + 2 when it is alone).
    """
    rules = facts.rules
    needs = [rule.needs for rule in rules.adjacency if set(tiles) <= set(rule.tiles)]
    needs = [need for need in needs if set(need) <= set(rules.connected)]
    if not needs or set(tiles) & set(rules.connected):
        return facts.free.size
    serves, holds, driving = (facts.may(group) for group in (needs[0], tiles, rules.connected))
    joints = serves & ndimage.binary_dilation(driving & ~serves, CROSS)
    parts = max(2, int(joints.sum()))
    return int(2 * (serves.sum() + (holds & ~serves).sum()) + parts) // 3


def _find_unserved(facts: Facts) -> str | None:
    """Name a fixed tile that needs a neighbour which no cell beside it may be."""
    for tiles, needs in facts.rules.adjacency:
        alone = facts.must(tiles) & ~ndimage.binary_dilation(facts.may(needs), BESIDE)
        if alone.any():
            row, col = np.argwhere(alone)[0]
            return (
                f"{tiles!r} needs {needs!r}, which no cell beside row {row}, column {col} may hold"
            )
    return None


def _find_cut_off(facts: Facts) -> str | None:
    """Name a fixed driving cell that fixed obstacles cut off from another one."""
    connected = facts.rules.connected
    labels, _ = ndimage.label(facts.may(connected), CROSS)
    always = facts.must(connected)
    parts = np.unique(labels[always])
    if not connected or parts.size <= 1:
        return None
    row, col = np.argwhere(always & (labels == parts[1]))[0]
    return f"fixed obstacles cut row {row}, column {col} off from the rest of {connected!r}"


def bound_cost(layout: np.ndarray, facts: Facts) -> float:
    """Bound the cost of repairing `layout` (int8 [H, W]) from below by the counts alone."""
    best, change_cost = 0.0, facts.rules.change_cost
    for bound in facts.rules.counts:
        holds = facts.holding(bound.tiles)[layout]
        count = int(holds.sum())
        # At best the cheapest cells change.
        if count < bound.low:
            best = max(best, np.sort(change_cost[~holds])[: bound.low - count].sum())
        elif bound.high is not None and count > bound.high:
            best = max(best, np.sort(change_cost[holds])[: count - bound.high].sum())
    return float(best)
