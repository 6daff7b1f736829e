"""Small windows of a nearly right layout, each solved to optimality with all else fixed.

Large neighbourhood search (Shaw 1998, https://doi.org/10.1007/3-540-49481-2_30). HiGHS takes
milliseconds for a window; on layouts that need few changes windows improve what the annealer
leaves, on others they do not, and the search soon stops.
"""

import highspy
import numpy as np
from scipy import ndimage

from qdenv.repair.milp.highs import Cut, add_cuts, load, new_solver, separate
from qdenv.repair.milp.program import Cells, Program, Rows, demand, total
from qdenv.repair.rules import Facts, Progress, excess, no_progress
from qdenv.repair.settings import WindowLimits

_AROUND = 2  # cells around a window that its rules look at: neighbours, and what serves these
_ROUNDS = 3  # solves of one window, each with more connectivity cuts
_MARGIN = 12  # cells around a window in which its parts may hang together
_USUAL_CELLS = 1000  # of a layout that `WindowLimits` are meant for
_NOISE = 0.4  # of the cheapest change: enough to draw among equals, too little to prefer others

_Box = tuple[slice, slice]  # rows and columns of a part of the layout


class WindowSearch:
    """One layout being improved, and the solver that improves it."""

    def __init__(self, layout: np.ndarray, best: np.ndarray, facts: Facts, seed: int):
        """Start at a feasible layout.

        Args:
            layout: int8 [H, W], the input.
            best: int8 [H, W], feasible; `candidate` is a copy of it.
            facts: the constraints.
            seed: of all draws.
        """
        self.layout, self.facts, self.candidate = layout, facts, best.copy()
        self.rng, self.solver = np.random.default_rng(seed), new_solver(seed)
        self.roles = facts.role_of[best]
        self.price = np.asarray(facts.rules.change_cost, np.float64)
        self.always = facts.must(facts.rules.connected)
        self.counts = np.bincount(best.ravel(), minlength=len(facts.rules.tiles))

    def run(self, limits: WindowLimits, progress: Progress = no_progress) -> np.ndarray:
        """Improve window by window while that pays; returns the best layout (int8 [H, W])."""
        granted = limits.windows * max(self.facts.free_cells / _USUAL_CELLS, 1.0)
        credit, waiting = granted, list[list[int]]()
        self.solver.setOptionValue("mip_max_nodes", limits.node_limit)
        while credit >= 1:
            if not waiting:
                # A new list now and then, not at each window: that would take the time of them all.
                changed = self.rng.permutation(np.argwhere(self.candidate != self.layout))
                waiting = changed[: max(len(changed) // limits.side, 1)].tolist()
            if not waiting:
                break
            row, col = waiting.pop()
            down, right = self.rng.integers(limits.side, size=2).tolist()
            gain = self.improve((row - down, col - right), limits.side)
            credit += limits.reward * gain - 1
            progress("solving windows", 1 - min(credit / granted, 1))
        return self.candidate

    def improve(self, corner: tuple[int, int], side: int) -> float:
        """Solve the window at a corner; adopt the solution if it costs no more.

        Args:
            corner: the first row and column; beyond the grid there is nothing.
            side: number of cells a side.

        Returns:
            How much the cost falls.
        """
        near, box = (self._box(corner, side, margin) for margin in (_AROUND, _MARGIN))
        window = self._box(corner, side, 0)
        cells = self._cells(near, window)
        inside = (cells.columns >= 0).any(-1)
        rows, cols = np.nonzero(inside)
        places = rows + near[0].start, cols + near[1].start
        columns = cells.columns[inside]
        kept, before = self.candidate[places], self.facts.driving[self.candidate[box]]
        cost = self._price_roles(places)[columns >= 0]
        if not cost.any():
            return 0.0
        noise = self.rng.random(cost.size) * _NOISE * cost[cost > 0].min() / cost.size
        ones = np.ones(cost.size)
        load(self.solver, Program(cells, cost + noise, self._rules(cells, near), ones, ones > 0))
        start, paid = highspy.HighsSolution(), self._cost(places)
        stands = np.arange(columns.shape[1]) == self.roles[places][:, None]
        start.col_value = stands[columns >= 0].astype(float).tolist()
        for _ in range(_ROUNDS):
            self.solver.setSolution(start)
            self.solver.run()
            feasible = highspy.SolutionStatus.kSolutionStatusFeasible
            if self.solver.getInfo().primal_solution_status != feasible:
                break
            values = np.array(self.solver.getSolution().col_value)
            roles = np.where(columns >= 0, values[columns], -1.0).argmax(1)
            self._place(places, roles)
            gain, cuts = paid - self._cost(places), self._find_cuts(before, box)
            if gain >= 0 and not cuts and excess(self.counts, self.facts) == 0:
                self.roles[places] = roles
                return gain
            self._put_back(places, kept)
            if gain < 0 or not cuts:
                break
            add_cuts(self.solver, self._cells(box, window), self.facts, cuts)
        return 0.0

    def _box(self, corner: tuple[int, int], side: int, margin: int) -> _Box:
        """Cut a window with a margin out of the layout."""
        low = (max(axis - margin, 0) for axis in corner)
        ends = zip(corner, self.layout.shape, strict=True)
        high = (max(min(axis + side + margin, end), 0) for axis, end in ends)
        rows, cols = (slice(first, last) for first, last in zip(low, high, strict=True))
        return rows, cols

    def _cells(self, box: _Box, window: _Box) -> Cells:
        """Number the binaries of a window's cells; all others in a box are constants."""
        free = np.zeros(self.facts.may_take[box].shape, bool)
        at = tuple(
            slice(w.start - b.start, w.stop - b.start) for w, b in zip(window, box, strict=True)
        )
        may = self.facts.may_take[window]
        # A cell with one role to choose from is a constant as well.
        free[at] = may & (may.sum(-1, keepdims=True) > 1)
        columns = np.where(free, np.cumsum(free).reshape(free.shape) - 1, -1)
        return Cells(columns, np.where(free.any(-1), -1, self.roles[box]))

    def _rules(self, cells: Cells, box: _Box) -> list[Rows]:
        """State every rule of the window but connectivity."""
        facts, columns = self.facts, cells.columns[(cells.columns >= 0).any(-1)]
        ones = np.ones(len(columns))
        rows = [Rows(columns, np.ones(columns.shape), ones, ones)]
        for rule in facts.rules.adjacency:
            needed = demand(cells, facts.roles_of(rule.tiles), facts.roles_of(rule.needs))
            # Rows that hold whatever happens are left out, and those the window does not touch: of
            # the negative terms at most one is set, as a cell takes one role.
            terms = needed.terms()
            least = np.where(terms, needed.values, 0.0).min(-1)
            columns, values, low, high = needed.select(terms.any(1) & (least < needed.low))
            rows.append(Rows(columns, -values, -high, -low))
        outside = np.bincount(self.roles.ravel(), minlength=len(facts.roles))
        outside -= np.bincount(self.roles[box].ravel(), minlength=outside.size)
        for (low, high), counting in zip(facts.count_bounds, facts.counting, strict=True):
            whole = facts.whole_roles(counting)
            # Kinds that are counted apart are the business of those who place them.
            if not (counting & ~whole[facts.role_of]).any():
                rest = outside[whole].sum()
                values, constant = cells.express(whole)
                rows.append(total(cells, values, constant, low - rest, high - rest))
        return rows

    def _price_roles(self, places: tuple[np.ndarray, ...]) -> np.ndarray:
        """Price each role on each of n cells (float64 [n, R]): what it costs to change to it."""
        own, old = self.layout[places], self.candidate[places]
        keeps = self.facts.rules.allowed[(*places, own)]
        roles = np.arange(len(self.facts.roles))
        stays = (roles == self.facts.role_of[own][:, None]) & keeps[:, None]
        # A cell whose role stays keeps the kind that it has been given.
        stays[np.arange(own.size), self.roles[places]] = own == old
        return self.price[places][:, None] * ~stays

    def _cost(self, places: tuple[np.ndarray, ...]) -> float:
        """Sum the costs of these cells."""
        return float(self.price[places][self.candidate[places] != self.layout[places]].sum())

    def _place(self, places: tuple[np.ndarray, ...], roles: np.ndarray) -> None:
        """Put tiles of these roles: as they are, else as in the input, else the rarest kind."""
        own, old = self.layout[places], self.candidate[places]
        for row, col, role, mine, stood in zip(*places, roles, own, old, strict=True):
            if self.roles[row, col] == role:
                continue
            tile = min(self.facts.roles[role], key=self.counts.__getitem__)
            if self.facts.role_of[mine] == role and self.facts.rules.allowed[row, col, mine]:
                tile = mine
            self.candidate[row, col] = tile
            self.counts[stood] -= 1
            self.counts[tile] += 1

    def _put_back(self, places: tuple[np.ndarray, ...], kept: np.ndarray) -> None:
        """Take a window back to the tiles `kept`."""
        kinds = self.counts.size
        self.counts -= np.bincount(self.candidate[places], minlength=kinds)
        self.counts += np.bincount(kept, minlength=kinds)
        self.candidate[places] = kept

    def _find_cuts(self, before: np.ndarray, box: _Box) -> list[Cut]:
        """Find cuts where the driving area, one piece with `before` in a box, may fall apart."""
        after = self.facts.driving[self.candidate[box]]
        # The cells of the box that have a neighbour outside.
        edges = np.zeros(after.shape, bool)
        (rows, cols), (height, width) = box, self.layout.shape
        edges[0] |= rows.start > 0
        edges[-1] |= rows.stop < height
        edges[:, 0] |= cols.start > 0
        edges[:, -1] |= cols.stop < width
        if not self.facts.rules.connected or stays_connected(before, after, edges):
            return []
        return separate(after, self.always[box])


def stays_connected(before: np.ndarray, after: np.ndarray, edges: np.ndarray) -> bool:
    """Return True if a driving area surely stays in one piece when a box of it changes.

    It does if what hung together on the open edges of the box still does, and nothing inside lost
    its way to them. Ways round outside the box are not looked for.

    Args:
        before: bool [h, w], the driving cells of the box when the area was in one piece.
        after: bool [h, w], those it would have; the same on the edges.
        edges: bool [h, w], cells with a neighbour outside the box.
    """
    old, _ = ndimage.label(before)
    new, pieces = ndimage.label(after)
    if pieces <= 1:
        return True
    ends = edges & after
    pairs = np.unique(np.stack([old[ends], new[ends]]), axis=1)
    return np.unique(pairs[1]).size == pieces and np.unique(pairs[0]).size == pairs.shape[1]
