"""Hand out the kinds of a role: which of three stations a new station becomes."""

import numpy as np

from qdenv.repair.audit import audit
from qdenv.repair.board import group_roles
from qdenv.types import Rules


def hand_out(
    roles: np.ndarray, home: np.ndarray, rules: Rules, rng: np.random.Generator
) -> np.ndarray:
    """Turn roles into tiles: kept tiles stay, new ones take the kind that is most wanting.

    Most wanting: below its bounds, else the least used. Kept tiles are turned into another kind
    of their role only where the bounds cannot be met otherwise.

    Args:
        roles: int64 [H, W], index into `group_roles(rules)`.
        home: int8 [H, W], the input.
        rules: the constraints.
        rng: breaks ties.

    Returns:
        int8 [H, W].
    """
    members = group_roles(rules)
    layout = np.array([role[0] for role in members], np.int8)[roles]
    rows, cols = np.indices(home.shape)
    stays = rules.allowed[rows, cols, home] & (role_of_kind(members)[home] == roles)
    layout = np.where(stays, home, layout)
    single = rules.allowed.sum(-1) == 1
    layout = np.where(single, rules.allowed.argmax(-1), layout).astype(np.int8)
    for index, kinds in enumerate(members):
        if len(kinds) > 1:
            mine = (roles == index) & ~single
            _share(layout, np.argwhere(mine & ~stays), np.argwhere(mine & stays), kinds, rules, rng)
    return layout


def balance(
    layout: np.ndarray, price: float, home: np.ndarray, rules: Rules, seed: int
) -> tuple[np.ndarray, float]:
    """Hand the kinds of a feasible `layout` out anew, where that costs no more.

    Returns:
        The layout (int8 [H, W]) and its price.
    """
    roles = group_roles(rules)
    if max(map(len, roles)) == 1:
        return layout, price
    shared = hand_out(role_of_kind(roles)[layout], home, rules, np.random.default_rng(seed))
    cost = float((rules.change_cost * (shared != home)).sum())
    return (layout, price) if cost > price or audit(shared, rules) else (shared, cost)


def role_of_kind(roles: list[list[int]]) -> np.ndarray:
    """Turn groups of kinds around: the role of each kind (int64 [K])."""
    table = np.zeros(sum(map(len, roles)), np.int64)
    for role, kinds in enumerate(roles):
        table[kinds] = role
    return table


def _share(
    layout: np.ndarray,
    fresh: np.ndarray,
    settled: np.ndarray,
    kinds: list[int],
    rules: Rules,
    rng: np.random.Generator,
) -> None:
    """Choose among `kinds` for the cells `fresh`, then turn cells of `settled` while it helps."""
    counts = np.bincount(layout.ravel(), minlength=len(rules.tiles))
    for cell in fresh:
        counts[layout[tuple(cell)]] -= 1
    for cell in rng.permutation(fresh):
        kind = min(kinds, key=lambda kind: (_need(counts, kind, 1, rules), counts[kind]))
        layout[tuple(cell)] = kind
        counts[kind] += 1
    for cell in rng.permutation(settled):
        if _excess(counts, rules) == 0:
            break
        old = layout[tuple(cell)]
        best = min(kinds, key=lambda kind: _swap_need(counts, old, kind, rules))
        if _swap_need(counts, old, best, rules) < 0:
            layout[tuple(cell)] = best
            counts[old] -= 1
            counts[best] += 1


def _excess(counts: np.ndarray, rules: Rules) -> int:
    """Sum how far the counts (int [K]) are outside their bounds."""
    total = 0
    for bound in rules.counts:
        count = sum(counts[rules.tiles.index(tile)] for tile in bound.tiles)
        high = count if bound.high is None else bound.high
        total += max(bound.low - count, 0) + max(count - high, 0)
    return int(total)


def _need(counts: np.ndarray, kind: int, step: int, rules: Rules) -> int:
    """Change of the excess when one more tile of `kind` (or one less) is there."""
    after = counts.copy()
    after[kind] += step
    return _excess(after, rules) - _excess(counts, rules)


def _swap_need(counts: np.ndarray, old: int, new: int, rules: Rules) -> int:
    """Change of the excess when a tile `old` turns into `new`."""
    after = counts.copy()
    after[old] -= 1
    return _need(after, new, 1, rules) + _need(counts, old, -1, rules)
