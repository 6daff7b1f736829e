"""Tables that follow from a domain's rules and that every step of the repair shares; bounds.

Only the audit derives its own tables, on purpose: it has to catch a mistake that is made here.
"""

from itertools import chain

import numpy as np

from qdenv.grid import count_neighbours
from qdenv.lazy import ndimage
from qdenv.types import Cover, Repair, Rules

_TOLERANCE = 1e-6  # how far a bound may miss a cost that it proves: sums of floats differ by less


class Facts:
    """What follows from `rules`, in tables over `K` tiles, `Q` counts and `R` roles.

    A *driving* tile is one of the connected group: its cells form the driving area. Tiles that no
    rule but counts tells apart share a *role*: three kinds of station differ in counts and in cost
    only.
    """

    def __init__(self, rules: Rules) -> None:
        """Compute the tables."""
        self.rules, tiles, allowed = rules, rules.tiles, rules.allowed
        self.free: np.ndarray = allowed.sum(-1) > 1  # bool [H, W], the cells that may change
        self.free_cells = int(self.free.sum())
        # int8 [H, W], an allowed tile for each cell
        self.any_layout: np.ndarray = allowed.argmax(-1).astype(np.int8)
        self.driving = self.holding(rules.connected)  # bool [K]
        # of each tile the adjacency demands: the tiles one of which must be a neighbour
        self.needs = [[rule.needs for rule in rules.adjacency if t in rule.tiles] for t in tiles]
        self.demands = np.array([len(needs) for needs in self.needs])  # int64 [K], how many
        # the adjacency demands that only driving cells meet
        self.services = [one for one in rules.adjacency if set(one.needs) <= set(rules.connected)]
        marks = [self.holding(bound.tiles) for bound in rules.counts]
        self.counting = np.array(marks, bool).reshape(-1, len(tiles))  # bool [Q, K]
        # int64 [Q, 2], the lowest and highest number of tiles that count in each bound
        pairs = [(low, self.free.size if high is None else high) for _, low, high in rules.counts]
        self.count_bounds = np.array(pairs, np.int64).reshape(-1, 2)
        # The symbols that each rule but counts is on.
        named = [rules.connected, *chain(*rules.adjacency)]
        named += chain(*((rule.tiles, rule.ends) for rule in rules.covers))
        named += [rules.straight.tiles] if rules.straight else []
        groups: dict[tuple[tuple[bool, ...], bytes], list[int]] = {}
        for kind, tile in enumerate(tiles):
            places = allowed[..., kind][self.free].tobytes()
            ruled = tuple(tile in symbols for symbols in named)
            groups.setdefault((ruled, places), []).append(kind)
        self.roles = list(groups.values())  # the tiles of each role, in the alphabet's order
        self.role_of = np.zeros(len(tiles), np.int64)  # int64 [K]
        for role, members in enumerate(self.roles):
            self.role_of[members] = role
        # bool [H, W, R], the roles that each cell may take
        self.may_take = np.stack([allowed[..., kinds].any(-1) for kinds in self.roles], -1)
        # of each cover, whether it is on the driving area, and the cells that need none (bool
        # [H, W]): where there is no room for a wide aisle, and shelves that are fixed
        self.widens = [set(rule.tiles) == set(rules.connected) for rule in rules.covers]
        sides: dict[bool, list[int]] = {True: [1], False: []}
        for rule, widens in zip(rules.covers, self.widens, strict=True):
            if not rule.ends:
                sides[widens].append(min(min(shape) for shape in rule.shapes))
        self.aisle = max(sides[True])  # how many cells wide an aisle must be
        # how many cells deep racks must be, 0 where any will do
        self.depth = max(sides[False], default=0)
        self.exempt = [
            ~self.room(rule) if widens else self.must(rule.tiles)
            for rule, widens in zip(rules.covers, self.widens, strict=True)
        ]
        # whether every change costs an integer, so that bounds on the cost round up
        self.whole_costs = bool((np.asarray(rules.change_cost) % 1 == 0).all())

    def holding(self, tiles: str) -> np.ndarray:
        """Mark which tiles of the alphabet are among `tiles` (bool [K])."""
        return np.array([tile in tiles for tile in self.rules.tiles])

    def roles_of(self, tiles: str) -> np.ndarray:
        """Mark the roles all of whose tiles are among `tiles` (bool [R])."""
        held = self.holding(tiles)
        return np.array([held[members].all() for members in self.roles])

    def may(self, tiles: str) -> np.ndarray:
        """Mark the cells that may hold one of `tiles` (bool [H, W])."""
        return (self.rules.allowed & self.holding(tiles)).any(-1)

    def must(self, tiles: str) -> np.ndarray:
        """Mark the cells that hold one of `tiles` in every layout (bool [H, W])."""
        return self.may(tiles) & ~(self.rules.allowed & ~self.holding(tiles)).any(-1)

    def room(self, rule: Cover) -> np.ndarray:
        """Mark the cells that a whole rectangle may cover (bool [H, W])."""
        may = self.may(rule.tiles)
        return np.any([ndimage.binary_opening(may, np.ones(shape)) for shape in rule.shapes], 0)

    def spare_ring(self, rule: Cover) -> int:
        """Return how many more cells may lie beside wide aisles than aisles have cells.

        Squares of 2 x 2 cells that hang together have at most four more: one alone does, and no
        other one adds more cells beside them than cells (tried for all ways to lie on others; the
        larger squares consist of such). A cell without room for a square counts twice, and pieces
        that hang together over such cells alone may each have two more.
        """
        room, narrow = self.room(rule), self.may(rule.tiles) & ~self.room(rule)
        return 2 + 2 * max(int(count_neighbours(narrow)[room].sum()), 1)

    def straightened(self, layout: np.ndarray) -> "Facts":
        """Choose straight aisles where `layout` (int8 [H, W]) has fewest obstacles, and keep them.

        Returns itself where no rule demands any.
        """
        if self.rules.straight is None:
            return self
        (tiles, most), allowed = self.rules.straight, self.rules.allowed.copy()
        barred = self.holding(tiles)
        for axis in (1, 0):
            may, other = (allowed & barred).any(-1), (allowed & ~barred).any(-1)
            # Where that is equal as few aisles as possible, on cells that matter least.
            cost = self.rules.change_cost * (may & barred[layout]) + 1e-3 * may
            lines = _choose_lines(np.where(may & ~other, np.inf, cost).sum(axis), most)
            clear = (lines[:, None] if axis else lines) & other
            allowed &= ~(clear[..., None] & barred)
        return Facts(self.rules._replace(allowed=allowed, straight=None))

    def keeps(self, layout: np.ndarray) -> np.ndarray:
        """Mark the cells that may keep the tile of `layout` (int8 [H, W] -> bool [H, W])."""
        rows, cols = np.indices(layout.shape)
        return np.asarray(self.rules.allowed[rows, cols, layout])

    def cost(self, candidate: np.ndarray, layout: np.ndarray) -> float:
        """Sum the costs of the cells in which `candidate` differs from the input `layout`."""
        return float((self.rules.change_cost * (candidate != layout)).sum())


def _choose_lines(cost: np.ndarray, most: int) -> np.ndarray:
    """Choose lines of the least `cost` (float [n] -> bool [n]), at most `most` between any two."""
    best, before = [0.0], [0]
    for place, own in enumerate([*cost, 0.0]):
        first = max(place - most, 0)
        before.append(first + int(np.argmin(best[first : place + 1])))
        best.append(best[before[-1]] + own)
    chosen, last = np.zeros(len(best), bool), len(best) - 1
    while last:
        chosen[last], last = True, before[last]
    return chosen[1:-1]


def is_proven(best: Repair, gap: float = 0.0) -> bool:
    """Return True if its bound proves the cost of the best layout so far within a relative gap."""
    return bool(best.lower_bound >= best.cost * (1 - gap) - _TOLERANCE)


def assign_kinds(
    roles: np.ndarray, layout: np.ndarray, facts: Facts, rng: np.random.Generator
) -> np.ndarray:
    """Turn `roles` (int64 [H, W]) into tiles (int8 [H, W]), near the input `layout` (int8 [H, W]).

    The input's tiles stay where their role does; new ones take a kind below its bounds, else the
    least used. Kept tiles are turned into another kind of their role only where the bounds cannot
    be met otherwise. `rng` breaks ties.
    """
    candidate = np.array([members[0] for members in facts.roles], np.int8)[roles]
    stays = facts.keeps(layout) & (facts.role_of[layout] == roles)
    candidate = np.where(stays, layout, candidate)
    fixed = facts.rules.allowed.sum(-1) == 1
    candidate = np.where(fixed, facts.any_layout, candidate).astype(np.int8)
    unit = np.eye(len(facts.rules.tiles), dtype=np.int64)
    # Plain numbers: a layout of a maze's size has thousands of cells to choose for.
    bounds = [
        (low, high, np.flatnonzero(marks).tolist())
        for (low, high), marks in zip(facts.count_bounds.tolist(), facts.counting, strict=True)
    ]
    for role, members in enumerate(facts.roles):
        if len(members) == 1:
            continue
        mine = (roles == role) & ~fixed
        held = np.bincount(candidate[~(mine & ~stays)], minlength=len(unit)).tolist()
        for cell in map(tuple, rng.permutation(np.argwhere(mine & ~stays))):
            ranks = []
            for kind in members:
                # How the excess changes if one more tile of this kind joins, then their number.
                change = 0
                for low, high, kinds in bounds:
                    if kind in kinds:
                        count = sum(held[other] for other in kinds)
                        change += (count >= high) - (count < low)
                ranks.append((change, held[kind]))
            kind = members[ranks.index(min(ranks))]
            candidate[cell] = kind
            held[kind] += 1
        counts = np.array(held)
        missing = excess(counts, facts)
        # Nothing is drawn unless a bound is missed: later draws depend on it.
        for cell in map(tuple, rng.permutation(np.argwhere(mine & stays)) if missing else ()):
            others = [counts - unit[candidate[cell]] + unit[kind] for kind in members]
            left = [excess(other, facts) for other in others]
            best = int(np.argmin(left))
            if left[best] < missing:
                candidate[cell], missing, counts = members[best], left[best], others[best]
            if missing == 0:
                break
    return candidate


def excess(counts: np.ndarray, facts: Facts) -> int:
    """Sum how far the counts (int [K]) are outside their bounds."""
    low, high = facts.count_bounds.T
    held = facts.counting @ counts
    return int(np.maximum(low - held, held - high).clip(0).sum())


def impossible(rules: Rules, facts: Facts | None = None) -> str | None:
    """Return a contradiction in `rules` that counting shows; None is no proof of a layout."""
    facts = facts or Facts(rules)
    if not rules.allowed.any(-1).all():
        row, col = np.argwhere(~rules.allowed.any(-1))[0]
        return f"no tile may stand at row {row}, column {col}"
    for bound in rules.counts:
        must, may = int(facts.must(bound.tiles).sum()), int(facts.may(bound.tiles).sum())
        high = may if bound.high is None else bound.high
        number = f"the number of {rules.name(bound.tiles, True)} must be"
        if bound.high is not None and bound.low > high:
            return f"{number} at least {bound.low} and at most {high}"
        if bound.low > may:
            return f"{number} at least {bound.low} but at most {may} fit"
        if high < must:
            return f"{number} at most {high} but {must} are fixed"
        # How many obstacles can a connected driving area serve? A part of c serving cells that
        # hangs together has 4c sides and spends 2 (c - 1) of them on itself, and one more where
        # something else joins it to the other parts: each part serves at most 2c + 1 obstacles
        # (2c + 2 when it is alone).
        needs = [rule.needs for rule in facts.services if set(bound.tiles) <= set(rule.tiles)]
        if not needs or set(bound.tiles) & set(rules.connected):
            continue
        groups = (needs[0], bound.tiles, rules.connected)
        serves, holds, driving = (facts.may(group) for group in groups)
        joints = serves & (count_neighbours(driving & ~serves) > 0)
        sides = int(2 * (serves.sum() + (holds & ~serves).sum()) + max(2, int(joints.sum())))
        if bound.low > (most := sides // 3):
            reach = f"a connected driving area can reach at most {most}"
            return f"{number} at least {bound.low} but {reach}"
    for tiles, others in rules.adjacency:
        alone = facts.must(tiles) & (count_neighbours(facts.may(others)) == 0)
        if alone.any():
            where = "row {}, column {}".format(*np.argwhere(alone)[0])
            demand = f"{rules.name(tiles)} at {where} needs {rules.name(others)} beside it"
            return f"{demand}, which no cell there may hold"
    labels, _ = ndimage.label(facts.may(rules.connected))
    always = facts.must(rules.connected)
    parts = np.unique(labels[always])
    if parts.size > 1:
        where = "row {}, column {}".format(*np.argwhere(always & (labels == parts[1]))[0])
        return f"fixed obstacles cut {where} off from the rest of the driving area"
    if rules.straight:
        stays = facts.must(rules.straight.tiles)
        for axis, lines in ((1, "rows"), (0, "columns")):
            labels, _ = ndimage.label(stays.any(axis))
            for (run,) in ndimage.find_objects(labels):
                if run.stop - run.start > rules.straight.most:
                    named, last = rules.name(rules.straight.tiles, True), run.stop - 1
                    where = f"{lines} {run.start} to {last}"
                    return f"{named} that stay leave no straight aisle in {where}"
    return _impossible_covers(facts)


def _impossible_covers(facts: Facts) -> str | None:
    """Return a contradiction between aisles or racks and the other rules that counting shows."""
    rules = facts.rules
    for rule, widens, exempt in zip(rules.covers, facts.widens, facts.exempt, strict=True):
        if rule.ends:
            continue
        rows, cols = rule.shapes[0]
        room = facts.room(rule)
        for tiles, low, high in rules.counts:
            number = f"the number of {rules.name(tiles, many=True)} must be"
            if widens:
                # A connected union of squares of a x a cells has at most (4 a - 2) / a^2
                # sides for each of its cells, and two more: squares that share one side each. A
                # cell without room for a square adds at most two sides. Each obstacle takes one.
                if not any(set(tiles) <= set(rule.tiles) for rule in facts.services):
                    continue
                ratio = (4 * rows - 2) / rows**2
                holds, narrow = facts.may(tiles), int((facts.may(rule.tiles) & ~room).sum())
                cells = int((room | holds).sum())
                most = int((ratio * cells + 2 * narrow + 2) / (1 + ratio))
                most = min(most, (cells + 2 * narrow + facts.spare_ring(rule)) // 2)
                if low > most and not set(tiles) & set(rules.connected):
                    reach = f"aisles {rows} cells wide can reach at most {most}"
                    return f"{number} at least {low} but {reach}"
            elif set(tiles) <= set(rule.tiles) and low > 0:
                rack = f"racks of {rows} x {cols}"
                most = int((room | exempt).sum())
                if low > most:
                    return f"{number} at least {low} but {rack} have room for at most {most}"
                if high is not None and high < rows * cols and not exempt.any():
                    return f"{number} at most {high} but {rack} take {rows * cols}"
            if widens or min(rows, cols) < 2:
                continue
            needs = [need for held, need in rules.adjacency if set(rule.tiles) <= set(held)]
            if all(set(need) & set(rule.tiles) for need in needs):
                continue
            if min(rows, cols) > 2 and low > facts.must(tiles).sum():
                lacks = f"the middle has no {rules.name(needs[0])} beside it"
                return f"in racks of {rows} x {cols} {lacks}"
            # Racks are squares of 2 x 2 cells. Two that share their corner would close in the cell
            # there, so those that overlap lie in a row, and each row has two lines.
            if low == high and low % 2 and set(tiles) == set(rule.tiles) and not exempt.any():
                return f"{number} {low} but racks 2 cells deep hold an even number"
    return None


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
