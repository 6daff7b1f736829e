"""The repair of one window as an integer program, all cells around it fixed.

One binary per cell of the window and role it may take. Built straight from the arrays of the few
cells concerned: the program of the whole layout (`program`) takes longer than a window's solution.
"""

from typing import NamedTuple

import highspy
import numpy as np

from qdenv.repair.facts import Facts
from qdenv.types import Adjacency

SIDES = ((1, 0), (-1, 0), (0, 1), (0, -1))
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
