"""What follows from a domain's rules: tables that every step of the repair shares, kinds, bounds.

Only the audit derives its own tables, on purpose: it has to catch a mistake that is made here.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from qdenv.grid import count_neighbours
from qdenv.lazy import ndimage
from qdenv.repair.audit import audit
from qdenv.types import Repair, RepairStatus, Rules

Progress = Callable[[str, float], None]  # receives what is being done, and which share of it is
_TOLERANCE = 1e-6  # how far a bound may miss a cost that it proves


def no_progress(doing: str, done: float) -> None:
    """Ignore how far a repair is."""


class Result(NamedTuple):
    """The best layout so far, and what is known of it."""

    layout: np.ndarray  # int8 [H, W]
    cost: float  # summed costs of its changed cells
    bound: float  # no layout costs less
    status: RepairStatus  # how the repair stands

    def proven(self, gap: float = 0.0) -> bool:
        """Return True if the bound proves the cost within a relative gap."""
        return self.bound >= self.cost * (1 - gap) - _TOLERANCE

    def record(self, seconds: float) -> Repair:
        """Make a `Repair` of numpy values with the types it promises."""
        numbers: list[Any] = [
            np.int32(self.status),
            np.float32(self.cost),
            np.float32(self.bound),
            np.float32(seconds),
        ]
        return Repair(self.layout.astype(np.int8), *numbers)


@dataclass(frozen=True, eq=False)
class Facts:
    """What follows from `rules`; each table is computed at its first use and cached.

    A *driving* tile is one of the connected group: its cells form the driving area. Tiles that no
    adjacency, connectivity or placement rule tells apart share a *role*: three kinds of station
    differ in counts and in cost only. `K` tiles, `Q` counts, `R` roles.
    """

    rules: Rules  # the constraints

    def holding(self, tiles: str) -> np.ndarray:
        """Mark which tiles of the alphabet are among `tiles` (bool [K])."""
        return np.array([tile in tiles for tile in self.rules.tiles])

    def roles_of(self, tiles: str) -> np.ndarray:
        """Mark the roles whose tiles are among `tiles` (bool [R])."""
        return self.holding(tiles)[[members[0] for members in self.roles]]

    def whole_roles(self, counting: np.ndarray) -> np.ndarray:
        """Mark the roles all of whose tiles count (bool [K] -> bool [R])."""
        return np.array([counting[members].all() for members in self.roles])

    def may(self, tiles: str) -> np.ndarray:
        """Mark the cells that may hold one of `tiles` (bool [H, W])."""
        return (self.rules.allowed & self.holding(tiles)).any(-1)

    def must(self, tiles: str) -> np.ndarray:
        """Mark the cells that hold one of `tiles` in every layout (bool [H, W])."""
        others = (self.rules.allowed & ~self.holding(tiles)).any(-1)
        return self.may(tiles) & ~others

    def keeps(self, layout: np.ndarray) -> np.ndarray:
        """Mark the cells that may keep the tile of `layout` (int8 [H, W] -> bool [H, W])."""
        rows, cols = np.indices(layout.shape)
        kept: np.ndarray = self.rules.allowed[rows, cols, layout]
        return kept

    def cost(self, candidate: np.ndarray, layout: np.ndarray) -> float:
        """Sum the costs of the cells in which `candidate` differs from the input `layout`."""
        return float((self.rules.change_cost * (candidate != layout)).sum())

    @cached_property
    def any_layout(self) -> np.ndarray:
        """An allowed tile for each cell (int8 [H, W])."""
        layout: np.ndarray = self.rules.allowed.argmax(-1).astype(np.int8)
        return layout

    @cached_property
    def driving(self) -> np.ndarray:
        """Mark the tiles of the connected group (bool [K])."""
        return self.holding(self.rules.connected)

    @cached_property
    def free(self) -> np.ndarray:
        """Mark the cells that may change (bool [H, W])."""
        return self.rules.allowed.sum(-1) > 1

    @cached_property
    def free_cells(self) -> int:
        """Count the cells that may change."""
        return int(self.free.sum())

    @cached_property
    def needs(self) -> list[list[str]]:
        """List each tile's adjacency demands: the tiles one of which must be a neighbour."""
        tiles, demanding = self.rules.tiles, self.rules.adjacency
        return [[rule.needs for rule in demanding if tile in rule.tiles] for tile in tiles]

    @cached_property
    def demands(self) -> np.ndarray:
        """Count each tile's adjacency demands (int64 [K])."""
        return np.array([len(needs) for needs in self.needs])

    @cached_property
    def counting(self) -> np.ndarray:
        """Mark which tiles count in which bound (bool [Q, K])."""
        marks = [self.holding(bound.tiles) for bound in self.rules.counts]
        return np.array(marks, bool).reshape(-1, len(self.rules.tiles))

    @cached_property
    def count_bounds(self) -> np.ndarray:
        """List the lowest and highest number of tiles that count in each bound (int64 [Q, 2])."""
        most = self.free.size
        pairs = [(low, most if high is None else high) for _, low, high in self.rules.counts]
        return np.array(pairs, np.int64).reshape(-1, 2)

    @cached_property
    def roles(self) -> list[list[int]]:
        """Group the tiles by role, in the order of the alphabet."""
        demanding = self.rules.adjacency
        groups: dict[tuple[bool, tuple[tuple[bool, bool], ...], bytes], list[int]] = {}
        for kind, tile in enumerate(self.rules.tiles):
            demands = tuple((tile in rule.tiles, tile in rule.needs) for rule in demanding)
            places = self.rules.allowed[..., kind][self.free].tobytes()
            groups.setdefault((bool(self.driving[kind]), demands, places), []).append(kind)
        return list(groups.values())

    @cached_property
    def role_of(self) -> np.ndarray:
        """Name each tile's role (int64 [K])."""
        table = np.zeros(len(self.rules.tiles), np.int64)
        for role, members in enumerate(self.roles):
            table[members] = role
        return table

    @cached_property
    def may_take(self) -> np.ndarray:
        """Mark the roles that each cell may take (bool [H, W, R])."""
        return np.stack([self.rules.allowed[..., kinds].any(-1) for kinds in self.roles], -1)

    @cached_property
    def whole_costs(self) -> bool:
        """Whether every change costs an integer, so that bounds on the cost round up."""
        return bool((np.asarray(self.rules.change_cost) % 1 == 0).all())


def assign_kinds(
    roles: np.ndarray, layout: np.ndarray, facts: Facts, rng: np.random.Generator
) -> np.ndarray:
    """Turn roles into tiles: kept tiles stay, new ones take the kind that the counts lack most.

    That is a kind below its bounds, else the least used. Kept tiles are turned into another kind
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
    fixed = facts.rules.allowed.sum(-1) == 1
    candidate = np.where(fixed, facts.any_layout, candidate).astype(np.int8)
    for role, members in enumerate(facts.roles):
        if len(members) > 1:
            mine = (roles == role) & ~fixed
            new, kept = np.argwhere(mine & ~stays), np.argwhere(mine & stays)
            _choose_kinds(candidate, rng.permutation(new), members, facts)
            if excess(_count_kinds(candidate, facts), facts):
                _turn_kinds(candidate, rng.permutation(kept), members, facts)
    return candidate


def balance_kinds(
    best: np.ndarray, cost: float, layout: np.ndarray, facts: Facts, seed: int
) -> tuple[np.ndarray, float]:
    """Assign the kinds of the feasible layout `best` again, where that costs no more.

    Returns:
        The layout (int8 [H, W]) and its cost.
    """
    if max(map(len, facts.roles)) == 1:
        return best, cost
    rng = np.random.default_rng(seed)
    candidate = assign_kinds(facts.role_of[best], layout, facts, rng)
    new_cost = facts.cost(candidate, layout)
    if new_cost > cost or audit(candidate, facts.rules):
        return best, cost
    return candidate, new_cost


def _count_kinds(layout: np.ndarray, facts: Facts) -> np.ndarray:
    """Count the tiles of each kind (int64 [K])."""
    return np.bincount(layout.ravel(), minlength=len(facts.rules.tiles))


def excess(counts: np.ndarray, facts: Facts) -> int:
    """Sum how far the counts (int [K]) are outside their bounds."""
    low, high = facts.count_bounds.T
    held = facts.counting @ counts
    return int(np.maximum(low - held, held - high).clip(0).sum())


def _choose_kinds(candidate: np.ndarray, new: np.ndarray, members: list[int], facts: Facts) -> None:
    """Choose among `members` for the cells `new` (int64 [n, 2])."""
    counts = _count_kinds(candidate, facts) - _count_kinds(candidate[tuple(new.T)], facts)
    # Plain numbers: a layout of a maze's size has thousands of cells to choose for.
    held = counts.tolist()
    bounds = [
        (low, high, np.flatnonzero(marks).tolist())
        for (low, high), marks in zip(facts.count_bounds.tolist(), facts.counting, strict=True)
    ]

    def rank(kind: int) -> tuple[int, int]:
        """Change of the excess if one more tile of this kind joins, then the number of them."""
        change = 0
        for low, high, kinds in bounds:
            if kind in kinds:
                count = sum(held[other] for other in kinds)
                change += (count >= high) - (count < low)
        return change, held[kind]

    for cell in new:
        kind = min(members, key=rank)
        candidate[tuple(cell)] = kind
        held[kind] += 1


def _turn_kinds(candidate: np.ndarray, kept: np.ndarray, members: list[int], facts: Facts) -> None:
    """Turn cells of `kept` (int64 [n, 2]) into other kinds while that brings a bound nearer."""
    counts = _count_kinds(candidate, facts)
    missing = excess(counts, facts)
    for cell in kept:
        if missing == 0:
            break
        old, left = candidate[tuple(cell)], {}
        for kind in members:
            after = counts.copy()
            after[old] -= 1
            after[kind] += 1
            left[kind] = excess(after, facts)
        best = min(members, key=left.__getitem__)
        if left[best] < missing:
            candidate[tuple(cell)], missing = best, left[best]
            counts[old] -= 1
            counts[best] += 1


def impossible(rules: Rules) -> str | None:
    """Return a contradiction in `rules` that counting shows, or None.

    None is no proof that a layout exists.
    """
    return find_contradiction(Facts(rules))


def find_contradiction(facts: Facts) -> str | None:
    """Return a contradiction as `impossible` does."""
    rules = facts.rules
    if not rules.allowed.any(-1).all():
        row, col = np.argwhere(~rules.allowed.any(-1))[0]
        return f"no tile may stand at row {row}, column {col}"
    for bound in rules.counts:
        must, may = int(facts.must(bound.tiles).sum()), int(facts.may(bound.tiles).sum())
        high = may if bound.high is None else bound.high
        if bound.low > high:
            return f"{bound.tiles!r} must number at least {bound.low} and at most {high}"
        if bound.low > may:
            return f"{bound.low} {bound.tiles!r} are required but only {may} cells may hold one"
        if high < must:
            return f"at most {high} {bound.tiles!r} are allowed but {must} cells must hold one"
        most = _count_servable(facts, bound.tiles)
        if bound.low > most:
            return (
                f"{bound.low} {bound.tiles!r} are required but a connected driving area "
                f"can reach at most {most}"
            )
    for tiles, needs in rules.adjacency:
        alone = facts.must(tiles) & (count_neighbours(facts.may(needs)) == 0)
        if alone.any():
            row, col = np.argwhere(alone)[0]
            return (
                f"{tiles!r} needs {needs!r}, which no cell beside row {row}, column {col} may hold"
            )
    if rules.connected:
        labels, _ = ndimage.label(facts.may(rules.connected))
        always = facts.must(rules.connected)
        parts = np.unique(labels[always])
        if parts.size > 1:
            row, col = np.argwhere(always & (labels == parts[1]))[0]
            return (
                f"fixed obstacles cut row {row}, column {col} off from the rest of "
                f"{rules.connected!r}"
            )
    return None


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
    joints = serves & (count_neighbours(driving & ~serves) > 0)
    parts = max(2, int(joints.sum()))
    return int(2 * (serves.sum() + (holds & ~serves).sum()) + parts) // 3


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
