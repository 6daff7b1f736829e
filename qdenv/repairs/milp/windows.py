"""Small windows of a nearly right layout, each solved to optimality with all else fixed.

Large neighbourhood search (Shaw 1998, https://doi.org/10.1007/3-540-49481-2_30). HiGHS takes
milliseconds for a window; on layouts that need few changes windows improve what the annealer
leaves, on others they do not, and the search soon stops.
"""

import highspy
import numpy as np
from scipy import ndimage

from qdenv.grid import count_neighbours
from qdenv.progress import Progress, silent
from qdenv.repairs.milp.highs import add_cuts, load, new_solver, separate
from qdenv.repairs.milp.program import Cells, Constraints, Program, demand, total
from qdenv.repairs.rules import Facts, excess

_SIDE = 8  # cells a side of one window
_WINDOWS = 6  # windows tried in vain on a layout of `_USUAL_CELLS`; more on larger ones
_USUAL_CELLS = 1000
_REWARD = 6.0  # more windows for each unit of cost that one has saved
_NODES = 1  # branch-and-bound nodes of one window: the relaxation and its cuts solve nearly all
_ROUNDS = 3  # solves of one window, each with more connectivity cuts
_AROUND = 2  # cells around a window that its rules look at: neighbours, and what serves these
_MARGIN = 12  # cells around a window in which its parts may hang together
_NOISE = 0.4  # of the cheapest change: enough to draw among equals, too little to prefer others

_Box = tuple[slice, slice]  # rows and columns of a part of the layout


class WindowSearch:
    """One layout being improved, and the solver that improves it."""

    def __init__(self, layout: np.ndarray, best: np.ndarray, facts: Facts, seed: int):
        """Start at the feasible layout `best`, to get near the input `layout` (int8 [H, W])."""
        self.layout, self.facts, self.candidate = layout, facts, best.copy()
        self.rng, self.solver = np.random.default_rng(seed), new_solver(seed)
        self.solver.setOptionValue("mip_max_nodes", _NODES)
        self.roles = facts.role_of[best]
        self.price = np.asarray(facts.rules.change_cost, np.float64)
        self.always = facts.must(facts.rules.connected)
        self.counts = np.bincount(best.ravel(), minlength=len(facts.rules.tiles))

    def run(self, progress: Progress = silent) -> np.ndarray:
        """Improve window by window while that pays; returns the best layout (int8 [H, W])."""
        granted = _WINDOWS * max(self.facts.free_cells / _USUAL_CELLS, 1.0)
        credit, waiting = granted, list[list[int]]()
        while credit >= 1:
            if not waiting:
                # A new list now and then, not at each window: that would take the time of them all.
                changed = self.rng.permutation(np.argwhere(self.candidate != self.layout))
                waiting = changed[: max(len(changed) // _SIDE, 1)].tolist()
            if not waiting:
                break
            row, col = waiting.pop()
            down, right = self.rng.integers(_SIDE, size=2).tolist()
            credit += _REWARD * self.improve((row - down, col - right), _SIDE) - 1
            progress("solving windows", 1 - min(credit / granted, 1), "")
        return self.candidate

    def improve(self, corner: tuple[int, int], side: int) -> float:
        """Solve the window of `side` cells a side at a corner, which may lie beyond the grid.

        The solution is adopted if it costs no more. Returns how much the cost falls.
        """
        window, near, box = (self._box(corner, side, margin) for margin in (0, _AROUND, _MARGIN))
        cells = self._cells(near, window)
        inside = (cells.columns >= 0).any(-1)
        rows, cols = np.nonzero(inside)
        places = rows + near[0].start, cols + near[1].start
        columns, own, kept = cells.columns[inside], self.layout[places], self.candidate[places]
        before, outside = self.facts.driving[self.candidate[box]], np.ones(self.layout.shape, bool)
        outside[box] = False
        edges = np.asarray(count_neighbours(outside)[box] > 0)
        # A role costs nothing where the input's tile has it and may stay. A cell whose role stays
        # keeps the kind that it has been given.
        keeps = self.facts.rules.allowed[(*places, own)]
        roles = np.arange(columns.shape[1])
        stays = (roles == self.facts.role_of[own][:, None]) & keeps[:, None]
        stays[np.arange(own.size), self.roles[places]] = own == kept
        cost = (self.price[places][:, None] * ~stays)[columns >= 0]
        if not cost.any():
            return 0.0
        noise = self.rng.random(cost.size) * _NOISE * cost[cost > 0].min() / cost.size
        ones = np.ones(cost.size)
        load(self.solver, Program(cells, cost + noise, self._rules(cells, near), ones, ones > 0))
        start, paid = highspy.HighsSolution(), self.price[places][kept != own].sum()
        stands = roles == self.roles[places][:, None]
        start.col_value = stands[columns >= 0].astype(float).tolist()
        for _ in range(_ROUNDS):
            self.solver.setSolution(start)
            self.solver.run()
            feasible = highspy.SolutionStatus.kSolutionStatusFeasible
            if self.solver.getInfo().primal_solution_status != feasible:
                break
            values = np.array(self.solver.getSolution().col_value)
            chosen = np.where(columns >= 0, values[columns], -1.0).argmax(1)
            self._place(places, chosen)
            gain = float(paid - self.price[places][self.candidate[places] != own].sum())
            after = self.facts.driving[self.candidate[box]]
            is_whole = stays_connected(before, after, edges)
            cuts = [] if is_whole else separate(after, self.always[box])
            if gain >= 0 and not cuts and excess(self.counts, self.facts) == 0:
                self.roles[places] = chosen
                return gain
            # Take the window back to what it was.
            self.counts -= np.bincount(self.candidate[places], minlength=self.counts.size)
            self.counts += np.bincount(kept, minlength=self.counts.size)
            self.candidate[places] = kept
            if gain < 0 or not cuts:
                break
            add_cuts(self.solver, self._cells(box, window), self.facts, cuts)
        return 0.0

    def _box(self, corner: tuple[int, int], side: int, margin: int) -> _Box:
        """Cut a window with a margin out of the layout."""
        first = np.maximum(np.array(corner) - margin, 0)
        last = np.clip(np.array(corner) + side + margin, 0, self.layout.shape)
        return slice(first[0], last[0]), slice(first[1], last[1])

    def _cells(self, box: _Box, window: _Box) -> Cells:
        """Number the binaries of a window's cells; all others in a box are constants."""
        inside = np.zeros(self.layout.shape, bool)
        inside[window] = True
        free = self.facts.may_take[box] & inside[box][..., None]
        free &= free.sum(-1, keepdims=True) > 1  # one role to choose from: a constant as well
        columns = np.where(free, np.cumsum(free).reshape(free.shape) - 1, -1)
        return Cells(columns, np.where(free.any(-1), -1, self.roles[box]))

    def _rules(self, cells: Cells, box: _Box) -> list[Constraints]:
        """State the rules of the window but connectivity, covers and kinds counted apart."""
        facts, columns = self.facts, cells.columns[(cells.columns >= 0).any(-1)]
        ones = np.ones(len(columns))
        rows = [Constraints(columns, np.ones(columns.shape), ones, ones)]
        for rule in facts.rules.adjacency:
            needed = demand(cells, facts.roles_of(rule.tiles), facts.roles_of(rule.needs))
            # Rows that hold whatever happens are left out, and those the window does not touch: of
            # the negative terms at most one is set, as a cell takes one role.
            terms = needed.terms()
            used = terms.any(1) & (np.where(terms, needed.values, 0.0).min(-1) < needed.low)
            columns, values, low, high = (field[used] for field in needed)
            rows.append(Constraints(columns, -values, -high, -low))
        outside = np.bincount(self.roles.ravel(), minlength=len(facts.roles))
        outside -= np.bincount(self.roles[box].ravel(), minlength=outside.size)
        for bound, (low, high) in zip(facts.rules.counts, facts.count_bounds, strict=True):
            whole = facts.roles_of(bound.tiles)
            # Kinds that are counted apart are not in the program: `_place` chooses them.
            if not (facts.holding(bound.tiles) & ~whole[facts.role_of]).any():
                rest = outside[whole].sum()
                values, constant = cells.express(whole)
                rows.append(total(cells, values, constant, low - rest, high - rest))
        return rows

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


def stays_connected(before: np.ndarray, after: np.ndarray, edges: np.ndarray) -> bool:
    """Return True if a driving area in one piece surely stays so when a box of it changes.

    The box drives on the cells `before` and `after` (bool [h, w]), the same of them on its `edges`
    (bool [h, w], with a neighbour outside). The area stays in one piece if what hung together on
    the open edges still does, and nothing inside lost its way to them. Ways round outside the box
    are not looked for.
    """
    old, _ = ndimage.label(before)
    new, pieces = ndimage.label(after)
    if pieces <= 1:
        return True
    ends = edges & after
    pairs = np.unique(np.stack([old[ends], new[ends]]), axis=1)
    return np.unique(pairs[1]).size == pieces and np.unique(pairs[0]).size == pairs.shape[1]
