"""What follows from a domain's rules, derived once for every step of the repair.

Only the audit derives its own, on purpose: it has to catch a mistake that is made here.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from qdenv.types import Rules


@dataclass(frozen=True, eq=False)
class Facts:
    """What follows from `rules`; everything is derived when first asked for, then kept.

    A *driving* tile is one of the connected group: its cells form the driving area. Tiles that no
    adjacency, connectivity or placement rule tells apart share a *role*: three kinds of station
    differ in counts and in cost only.
    """

    rules: Rules  # the constraints

    def holding(self, tiles: str) -> np.ndarray:
        """Mark which tiles of the alphabet are among `tiles` (bool [K])."""
        return np.array([tile in tiles for tile in self.rules.tiles])

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
    def driving(self) -> np.ndarray:
        """Mark the tiles of the connected group (bool [K])."""
        return self.holding(self.rules.connected)

    @cached_property
    def free(self) -> np.ndarray:
        """Mark the cells that may change (bool [H, W])."""
        return self.rules.allowed.sum(-1) > 1

    @cached_property
    def fixed(self) -> np.ndarray:
        """Mark the cells that allow one tile only (bool [H, W])."""
        return self.rules.allowed.sum(-1) == 1

    @cached_property
    def free_cells(self) -> int:
        """Count the cells that may change."""
        return int(self.free.sum())

    @cached_property
    def needs(self) -> list[list[str]]:
        """List each tile's adjacency demands: the tiles one of which must be beside it."""
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
    def bounded_kinds(self) -> list[tuple[int, int, list[int]]]:
        """List the lowest and highest number in each bound, then the tiles that count in it."""
        pairs = zip(self.count_bounds.tolist(), self.counting, strict=True)
        return [(low, high, np.flatnonzero(counts).tolist()) for (low, high), counts in pairs]

    @cached_property
    def roles(self) -> list[list[int]]:
        """Group the tiles by role, in the order of the alphabet."""
        demanding = self.rules.adjacency
        groups: dict[tuple[bool, tuple[tuple[bool, bool], ...], bytes], list[int]] = {}
        for kind, tile in enumerate(self.rules.tiles):
            beside = tuple((tile in rule.tiles, tile in rule.needs) for rule in demanding)
            places = self.rules.allowed[..., kind][self.free].tobytes()
            groups.setdefault((bool(self.driving[kind]), beside, places), []).append(kind)
        return list(groups.values())

    @cached_property
    def role_of(self) -> np.ndarray:
        """Name each tile's role (int64 [K])."""
        table = np.zeros(len(self.rules.tiles), np.int64)
        for role, members in enumerate(self.roles):
            table[members] = role
        return table

    @cached_property
    def whole_costs(self) -> bool:
        """Whether every change costs an integer, so that bounds on the cost round up."""
        return bool((np.asarray(self.rules.change_cost) % 1 == 0).all())
