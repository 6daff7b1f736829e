"""What counting alone shows: rules no layout can obey, and a lower bound on the price."""

import numpy as np

from qdenv.types import Rules


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
    return None


def price_bound(layout: np.ndarray, rules: Rules) -> float:
    """Bound the repair's price from below by the counts alone."""
    best = 0.0
    for bound in rules.counts:
        holds = np.isin(np.array(list(rules.tiles))[layout], list(bound.tiles))
        count = int(holds.sum())
        if count < bound.low:
            best = max(best, np.sort(rules.weights[~holds])[: bound.low - count].sum())
        elif bound.high is not None and count > bound.high:
            best = max(best, np.sort(rules.weights[holds])[: count - bound.high].sum())
    return float(best)
