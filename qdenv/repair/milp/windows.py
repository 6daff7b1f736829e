"""The repair of one window as an integer program, all cells around it fixed.

One binary per cell of the window and role it may take. Built straight from the arrays of the few
cells concerned: the program of the whole layout (`program`) takes longer than a window's solution.
"""

from typing import NamedTuple

import highspy
import numpy as np
from scipy import ndimage

from qdenv.grid import MOVES
from qdenv.repair.milp.highs import CROSS, Cut, separate
from qdenv.repair.rules import Facts, Report, excess, no_report
from qdenv.repair.settings import WindowLimits
from qdenv.types import Adjacency

SIDES = (*MOVES[2:], *MOVES[:2])
AROUND = 2  # cells around a window that its rules look at: neighbours, and what serves these


class Cells(NamedTuple):
    """The cells of a window and those around it, as far as its rules look."""

    top: int  # row of the first of them in the layout; may be negative, outside the grid
    left: int  # its column
    roles: np.ndarray  # int64 [h, w], the role that stands there, -1 outside the grid
    columns: np.ndarray  # int64 [h, w, R], the variable "the cell takes the role", -1 for none

    @property
    def inside(self) -> np.ndarray:
        """Mark the cells that may change (bool [h, w])."""
        return np.asarray((self.columns >= 0).any(-1))

    @property
    def places(self) -> tuple[np.ndarray, np.ndarray]:
        """List the rows and columns in the layout of the cells that may change."""
        rows, cols = np.nonzero(self.inside)
        return rows + self.top, cols + self.left


class Rows(NamedTuple):
    """Rows ``low <= sum of values * variables <= high``, as triplets."""

    row: np.ndarray  # int64 [entries], which row an entry belongs to
    column: np.ndarray  # int64 [entries], its variable
    value: np.ndarray  # float64 [entries]
    low: np.ndarray  # float64 [rows]
    high: np.ndarray  # float64 [rows]


def cut_out(roles: np.ndarray, may: np.ndarray, corner: tuple[int, int], size: int) -> Cells:
    """Cut a window out of a layout.

    Args:
        roles: int64 [H, W], the role that stands in each cell.
        may: bool [H, W, R], the roles it may take; for fixed cells only its own.
        corner: the window's first row and column.
        size: its side; beyond the grid there is nothing.
    """
    (top, left), side = (axis - AROUND for axis in corner), size + 2 * AROUND
    shape = (side, side)
    held, open_to = np.full(shape, -1), np.zeros((*shape, may.shape[2]), bool)
    rows = slice(max(top, 0), min(top + side, roles.shape[0]))
    cols = slice(max(left, 0), min(left + side, roles.shape[1]))
    here = (slice(rows.start - top, rows.stop - top), slice(cols.start - left, cols.stop - left))
    held[here] = roles[rows, cols]
    open_to[here] = may[rows, cols]
    open_to[:AROUND] = open_to[-AROUND:] = open_to[:, :AROUND] = open_to[:, -AROUND:] = False
    open_to &= open_to.sum(-1, keepdims=True) > 1
    columns = np.where(open_to, np.cumsum(open_to).reshape(open_to.shape) - 1, -1)
    return Cells(top, left, held, columns)


def _shifted(array: np.ndarray, side: tuple[int, int], empty: int) -> np.ndarray:
    """Look at the neighbour on one side of each cell; `empty` beyond the array."""
    moved = np.roll(array, side, (0, 1))
    down, right = side
    if down:
        moved[0 if down > 0 else -1] = empty
    if right:
        moved[:, 0 if right > 0 else -1] = empty
    return moved


def _one_role(cells: Cells) -> Rows:
    """Each cell takes one role."""
    columns = cells.columns[cells.inside]
    row, role = np.nonzero(columns >= 0)
    ones = np.ones(len(columns))
    return Rows(row, columns[row, role], np.ones(row.size), ones, ones)


def _adjacency(cells: Cells, tiles: np.ndarray, needs: np.ndarray) -> Rows:
    """A cell with one of the roles `tiles` (bool [R]) has a neighbour with one of `needs`."""
    inside, held = cells.inside, cells.roles
    fixed = ~inside & (held >= 0)
    serves = (fixed & needs[held]).astype(int)
    around = np.stack([_shifted(cells.columns[..., needs], side, -1) for side in SIDES], 2)
    around = around.reshape(*held.shape, -1)
    served = sum(_shifted(serves, side, 0) for side in SIDES) > 0
    own = np.where(tiles, cells.columns, -1)
    # Cells that are served whatever happens need no row, nor those the window does not touch.
    wants = (own >= 0).any(-1) | (fixed & tiles[held] & (around >= 0).any(-1))
    wants &= ~served
    entries = np.concatenate([own[wants], around[wants]], -1)
    values = np.repeat([1.0, -1.0], [own.shape[-1], around.shape[-1]])
    row, place = np.nonzero(entries >= 0)
    high = np.where(inside[wants], 0.0, -1.0)
    return Rows(row, entries[row, place], values[place], np.full(high.size, -np.inf), high)


def _counts(cells: Cells, facts: Facts, held: np.ndarray) -> list[Rows]:
    """Keep the counts of whole roles within their bounds."""
    inside, roles = cells.inside, len(facts.roles)
    outside = held - np.bincount(cells.roles[inside], minlength=roles)
    found = []
    for (low, high), counting in zip(facts.count_bounds, facts.counting, strict=True):
        whole = np.array([counting[members].all() for members in facts.roles])
        # Kinds that are counted apart are the business of those who place them.
        if counting.sum() > sum(len(facts.roles[role]) for role in np.flatnonzero(whole)):
            continue
        columns = cells.columns[..., whole]
        columns, rest = columns[columns >= 0], outside[whole].sum()
        zeros, ones = np.zeros(columns.size, int), np.ones(columns.size)
        limits = (np.array([float(limit - rest)]) for limit in (low, high))
        found.append(Rows(zeros, columns, ones, *limits))
    return found


def _holding(facts: Facts, tiles: str) -> np.ndarray:
    """Mark the roles whose tiles are among `tiles` (bool [R])."""
    return np.array([facts.holding(tiles)[members[0]] for members in facts.roles])


def state_rules(cells: Cells, facts: Facts, held: np.ndarray) -> list[Rows]:
    """State every rule of the window but connectivity, as `_counts` takes its arguments."""
    demands: tuple[Adjacency, ...] = facts.rules.adjacency
    near = [
        _adjacency(cells, _holding(facts, rule.tiles), _holding(facts, rule.needs))
        for rule in demands
    ]
    return [_one_role(cells), *near, *_counts(cells, facts, held)]


def load_window(solver: highspy.Highs, cost: np.ndarray, parts: list[Rows]) -> None:
    """Pass the program of a window, with binaries of this cost (float64 [variables])."""
    starts = np.cumsum([0, *(part.low.size for part in parts)])
    row = np.concatenate([part.row + start for part, start in zip(parts, starts[:-1], strict=True)])
    order = np.argsort(row, kind="stable")
    model = highspy.HighsLp()
    model.num_col_, model.num_row_ = cost.size, int(starts[-1])
    model.col_cost_ = cost
    model.col_lower_, model.col_upper_ = np.zeros(cost.size), np.ones(cost.size)
    model.row_lower_ = np.concatenate([part.low for part in parts])
    model.row_upper_ = np.concatenate([part.high for part in parts])
    model.a_matrix_.format_ = highspy.MatrixFormat.kRowwise
    model.a_matrix_.start_ = np.searchsorted(row[order], np.arange(starts[-1] + 1)).astype(np.int32)
    model.a_matrix_.index_ = np.concatenate([part.column for part in parts])[order].astype(np.int32)
    model.a_matrix_.value_ = np.concatenate([part.value for part in parts])[order]
    model.integrality_ = [highspy.HighsVarType.kInteger] * cost.size
    solver.passModel(model)


ROUNDS = 3  # solves of one window, each with more connectivity cuts
MARGIN = 12  # cells around a window in which its parts may hang together
USUAL_CELLS = 1000  # of a layout that `WindowLimits` are meant for
NOISE = 0.4  # of the cheapest change: enough to draw among equals, too little to prefer others

Places = tuple[np.ndarray, np.ndarray]  # rows and columns of cells


class WindowSearch:
    """One layout under way, and the solver that improves it."""

    def __init__(self, layout: np.ndarray, best: np.ndarray, facts: Facts, seed: int):
        """Start at a feasible layout.

        Args:
            layout: int8 [H, W], the input.
            best: int8 [H, W], feasible; `candidate` is a copy of it.
            facts: the constraints.
            seed: of all draws.
        """
        self.layout, self.facts, self.candidate = layout, facts, best.copy()
        self.rng, self.solver = np.random.default_rng(seed), highspy.Highs()
        options = {"output_flag": False, "threads": 1, "random_seed": seed % (1 << 31)}
        for name, value in options.items():
            self.solver.setOptionValue(name, value)
        may = np.stack([facts.rules.allowed[..., kinds].any(-1) for kinds in facts.roles], -1)
        self.roles, self.may = facts.role_of[best], may
        self.price = np.asarray(facts.rules.change_cost, np.float64)
        self.always = facts.must(facts.rules.connected)
        self.counts = np.bincount(best.ravel(), minlength=len(facts.rules.tiles))

    def run(self, limits: WindowLimits, report: Report = no_report) -> np.ndarray:
        """Improve window by window while that pays; returns the best layout (int8 [H, W])."""
        granted = limits.windows * max(self.facts.free_cells / USUAL_CELLS, 1.0)
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
            report("solving windows", 1 - min(credit / granted, 1))
        return self.candidate

    def improve(self, corner: tuple[int, int], side: int) -> float:
        """Solve the window at a corner, keep what costs no more; returns how much it gains."""
        cells, box = cut_out(self.roles, self.may, corner, side), self._surroundings(corner, side)
        places = cells.places
        kept, before = self.candidate[places], self.facts.driving[self.candidate[box]]
        cost = self._price_roles(places)[cells.columns[cells.inside] >= 0]
        if not cost.any():
            return 0.0
        held = np.array([self.counts[members].sum() for members in self.facts.roles])
        noise = self.rng.random(cost.size) * NOISE * cost[cost > 0].min() / cost.size
        load_window(self.solver, cost + noise, state_rules(cells, self.facts, held))
        start, paid = self._start(cells), self._cost(places)
        for _ in range(ROUNDS):
            roles = self._solve(cells, start)
            if roles is None:
                break
            self._place(places, roles)
            gain, cuts = paid - self._cost(places), self._find_cuts(before, box)
            if gain >= 0 and not cuts and excess(self.counts, self.facts) == 0:
                self.roles[places] = roles
                return gain
            self._put_back(places, kept)
            if gain < 0 or not cuts:
                break
            for cut in cuts:
                self._forbid(cells, box, cut)
        return 0.0

    def _price_roles(self, places: Places) -> np.ndarray:
        """Price each role on each of n cells (float64 [n, R]): what it costs to change to it."""
        own, old = self.layout[places], self.candidate[places]
        keeps = self.facts.rules.allowed[(*places, own)]
        stays = (np.arange(self.may.shape[2]) == self.facts.role_of[own][:, None]) & keeps[:, None]
        # A cell whose role stays keeps the kind that it has been given.
        stays[np.arange(own.size), self.roles[places]] = own == old
        return self.price[places][:, None] * ~stays

    def _cost(self, places: Places) -> float:
        """Sum the costs of these cells."""
        return float(self.price[places][self.candidate[places] != self.layout[places]].sum())

    def _start(self, cells: Cells) -> highspy.HighsSolution:
        """Express what stands in the window as values of its variables."""
        solution, columns = highspy.HighsSolution(), cells.columns[cells.inside]
        stands = np.arange(self.may.shape[2]) == cells.roles[cells.inside][:, None]
        solution.col_value = stands[columns >= 0].astype(float).tolist()
        return solution

    def _solve(self, cells: Cells, start: highspy.HighsSolution) -> np.ndarray | None:
        """Solve the program as it stands; returns the roles of the cells that may change."""
        self.solver.setSolution(start)
        self.solver.run()
        feasible = highspy.SolutionStatus.kSolutionStatusFeasible
        if self.solver.getInfo().primal_solution_status != feasible:
            return None
        values = np.array(self.solver.getSolution().col_value)
        columns = cells.columns[cells.inside]
        roles: np.ndarray = np.where(columns >= 0, values[columns], -1.0).argmax(1)
        return roles

    def _place(self, places: Places, roles: np.ndarray) -> None:
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

    def _put_back(self, places: Places, kept: np.ndarray) -> None:
        """Take a window back to the tiles `kept`."""
        kinds = self.counts.size
        self.counts -= np.bincount(self.candidate[places], minlength=kinds)
        self.counts += np.bincount(kept, minlength=kinds)
        self.candidate[places] = kept

    def _surroundings(self, corner: tuple[int, int], side: int) -> tuple[slice, slice]:
        """Choose the part of the layout in which a window's changes must hang together."""
        low = (max(axis - MARGIN, 0) for axis in corner)
        high = (axis + side + MARGIN for axis in corner)
        rows, cols = (slice(first, last) for first, last in zip(low, high, strict=True))
        return rows, cols

    def _find_cuts(self, before: np.ndarray, box: tuple[slice, slice]) -> list[Cut]:
        """Find cuts where the driving area, one piece with `before` in a box, may fall apart."""
        after = self.facts.driving[self.candidate[box]]
        if not self.facts.rules.connected or hangs_together(before, after, self._open_edges(box)):
            return []
        return separate(after, self.always[box])

    def _open_edges(self, box: tuple[slice, slice]) -> np.ndarray:
        """Mark the cells of a box that have a neighbour outside (bool [h, w])."""
        edges = np.zeros(self.layout[box].shape, bool)
        (rows, cols), (height, width) = box, self.layout.shape
        edges[0] |= rows.start > 0
        edges[-1] |= rows.stop < height
        edges[:, 0] |= cols.start > 0
        edges[:, -1] |= cols.stop < width
        return edges

    def _forbid(self, cells: Cells, box: tuple[slice, slice], cut: Cut) -> None:
        """Add a connectivity cut, whose positions are those in a box, as a row."""
        width, high = self.layout[box].shape[1], len(cut.ends) - 1.0
        drives = self.facts.driving[[members[0] for members in self.facts.roles]]
        columns, values = [], []
        for sign, positions in ((1.0, cut.ends), (-1.0, cut.gates)):
            rows, cols = np.divmod(np.array(positions, int), width)
            rows, cols = rows + box[0].start - cells.top, cols + box[1].start - cells.left
            near = (rows >= 0) & (cols >= 0) & (rows < len(cells.roles)) & (cols < len(cells.roles))
            own = np.full((rows.size, drives.sum()), -1)
            own[near] = cells.columns[rows[near], cols[near]][:, drives]
            # Cells that stay as they are: the ends of a cut drive, its gates do not.
            high -= (sign > 0) * (own < 0).all(1).sum()
            columns.append(own[own >= 0])
            values.append(np.full(columns[-1].size, sign))
        column = np.concatenate(columns).astype(np.int32)
        self.solver.addRow(-np.inf, high, column.size, column, np.concatenate(values))


def hangs_together(before: np.ndarray, after: np.ndarray, edges: np.ndarray) -> bool:
    """Whether a driving area stays in one piece when a box of it changes.

    It does if what hung together on the open edges of the box still does, and nothing inside lost
    its way to them. Ways round outside the box are not looked for.

    Args:
        before: bool [h, w], the driving cells of the box when the area was in one piece.
        after: bool [h, w], those it would have; the same on the edges.
        edges: bool [h, w], cells with a neighbour outside the box.
    """
    old, _ = ndimage.label(before, CROSS)
    new, pieces = ndimage.label(after, CROSS)
    if pieces <= 1:
        return True
    ends = edges & after
    pairs = np.unique(np.stack([old[ends], new[ends]]), axis=1)
    return np.unique(pairs[1]).size == pieces and np.unique(pairs[0]).size == pairs.shape[1]
