"""Hand out the kinds of a role: which of three stations a new station becomes."""

import numpy as np

from qdenv.repair.audit import audit
from qdenv.repair.facts import Facts


def hand_out(
    roles: np.ndarray, layout: np.ndarray, facts: Facts, rng: np.random.Generator
) -> np.ndarray:
    """Turn roles into tiles: kept tiles stay, new ones take the kind that is most wanting.

    Most wanting: below its bounds, else the least used. Kept tiles are turned into another kind
    of their role only where the bounds cannot be met otherwise.

    Args:
        roles: int64 [H, W], index into `facts.roles`.
        layout: int8 [H, W], the input.
        facts: the constraints.
        rng: breaks ties.

    Returns:
        int8 [H, W].
    """
    candidate = np.array([members[0] for members in facts.roles], np.int8)[roles]
    stays = facts.keeps(layout) & (facts.role_of[layout] == roles)
    candidate = np.where(stays, layout, candidate)
    only = facts.rules.allowed.argmax(-1)
    candidate = np.where(facts.fixed, only, candidate).astype(np.int8)
    for role, members in enumerate(facts.roles):
        if len(members) > 1:
            mine = (roles == role) & ~facts.fixed
            new, kept = np.argwhere(mine & ~stays), np.argwhere(mine & stays)
            counts = _choose_kinds(candidate, new, members, facts, rng)
            _turn_kinds(candidate, kept, members, counts, facts, rng)
    return candidate


def balance(
    best: np.ndarray, cost: float, layout: np.ndarray, facts: Facts, seed: int
) -> tuple[np.ndarray, float]:
    """Hand the kinds of the feasible layout `best` out anew, where that costs no more.

    Returns:
        The layout (int8 [H, W]) and its cost.
    """
    if max(map(len, facts.roles)) == 1:
        return best, cost
    rng = np.random.default_rng(seed)
    candidate = hand_out(facts.role_of[best], layout, facts, rng)
    new_cost = facts.cost(candidate, layout)
    if new_cost > cost or audit(candidate, facts.rules):
        return best, cost
    return candidate, new_cost


def _choose_kinds(
    candidate: np.ndarray,
    new: np.ndarray,
    members: list[int],
    facts: Facts,
    rng: np.random.Generator,
) -> np.ndarray:
    """Choose among `members` for the cells `new` (int64 [n, 2]); returns the counts (int [K])."""
    counts = np.bincount(candidate.ravel(), minlength=len(facts.rules.tiles))
    counts -= np.bincount(candidate[tuple(new.T)], minlength=counts.size)
    # Which cell gets which kind is left to chance: only the numbers of each are chosen.
    held, chosen = counts.tolist(), []
    for _ in range(len(new)):
        kind = min(members, key=lambda kind: (_excess_of_one_more(held, kind, facts), held[kind]))
        chosen.append(kind)
        held[kind] += 1
    candidate[tuple(rng.permutation(new).T)] = chosen
    return np.array(held)


def _turn_kinds(
    candidate: np.ndarray,
    kept: np.ndarray,
    members: list[int],
    counts: np.ndarray,
    facts: Facts,
    rng: np.random.Generator,
) -> None:
    """Turn cells of `kept` (int64 [n, 2]) into other kinds while that brings a bound nearer."""
    wanting = excess(counts, facts)
    for cell in rng.permutation(kept) if wanting else ():
        if wanting == 0:
            break
        old, left = candidate[tuple(cell)], {}
        for kind in members:
            after = counts.copy()
            after[old] -= 1
            after[kind] += 1
            left[kind] = excess(after, facts)
        best = min(members, key=left.__getitem__)
        if left[best] < wanting:
            candidate[tuple(cell)], wanting = best, left[best]
            counts[old] -= 1
            counts[best] += 1


def excess(counts: np.ndarray, facts: Facts) -> int:
    """Sum how far the counts (int [K]) are outside their bounds."""
    low, high = facts.count_bounds.T
    held = facts.counting @ counts
    return int(np.maximum(low - held, held - high).clip(0).sum())


def _excess_of_one_more(held: list[int], kind: int, facts: Facts) -> int:
    """Change of the excess when one more tile of `kind` joins `held` of each."""
    change = 0
    for low, high, kinds in facts.bounded_kinds:
        if kind in kinds:
            count = sum(held[other] for other in kinds)
            change += (count >= high) - (count < low)
    return change
