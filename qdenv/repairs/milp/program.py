"""The repair as an integer program, of a whole layout or of a window in it, all else fixed.

One binary per cell and role (tiles that no rule tells apart share a role: the three kinds of
station are one). In the program of a whole layout a cell's base role is what is left when no binary
is set; in a window all roles have binaries, and the cells around it are constants. Which kind a new
tile of a role becomes is a handful of integers here, and is assigned afterwards
(`rules.assign_kinds`). Connectivity is not in the program: `highs.separate` cuts off the solutions
that break it.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from qdenv.grid import MOVES, shift
from qdenv.repairs.rules import Facts

_Term = tuple[int, float]  # a column and its coefficient


class Cells(NamedTuple):
    """The variables behind the roles of the cells."""

    columns: np.ndarray  # int64 [H, W, R], the binary "the cell holds the role", -1 for none
    # int64 [H, W], the role a cell holds when none of its binaries is set, -1 where one must be set
    base: np.ndarray

    def express(self, roles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Express "the cell holds one of `roles`" (bool [R]): terms [H, W, R], constants [H, W]."""
        # Where the base role is one of `roles`, each binary of another role takes the 1 away.
        constant = (roles[self.base] & (self.base >= 0)).astype(float)
        return roles - constant[..., None], constant


class Constraints(NamedTuple):
    """Rows ``low <= sum(values * v[columns]) <= high`` in the variables v."""

    columns: np.ndarray  # int64 [rows, terms], -1 for no term
    values: np.ndarray  # float64 [rows, terms]
    low: np.ndarray  # float64 [rows]
    high: np.ndarray  # float64 [rows]

    def terms(self) -> np.ndarray:
        """Mark the terms that are there (bool [rows, terms])."""
        return (self.columns >= 0) & (self.values != 0)


class Program(NamedTuple):
    """Minimise ``cost @ v + constant`` within the rows and ``0 <= v <= upper``."""

    cells: Cells
    cost: np.ndarray  # float64 [variables]
    rows: list[Constraints]
    upper: np.ndarray  # float64 [variables]
    integer: np.ndarray  # bool [variables]
    constant: float = 0.0  # cost when all variables are 0
    # of each kind that is counted apart from others of its role the columns of two integers: how
    # many cells become it, and how many of its input cells keep the role but not the kind
    retypes: dict[int, tuple[int, int]] = {}  # noqa: RUF012
    # of each shape of each cover: int64 [H, W], column of "the rectangle whose first corner is here
    # is whole", or -1
    wholes: tuple[np.ndarray, ...] = ()
    # int64 [H] and [W], columns of "the row, or the column, is a straight aisle"; () without a rule
    lines: tuple[np.ndarray, ...] = ()


def at_least(low: np.ndarray, *terms: tuple[np.ndarray, np.ndarray | float]) -> Constraints:
    """Make rows ``low <= ...`` of columns and values ([rows, terms] or [rows]) side by side."""
    columns = np.column_stack([part for part, _ in terms])
    values = np.column_stack([np.broadcast_to(value, part.shape) for part, value in terms])
    return Constraints(columns, values, low, np.full(len(low), np.inf))


def demand(cells: Cells, tiles: np.ndarray, needs: np.ndarray) -> Constraints:
    """Demand of cells with roles `tiles` (bool [R]) a neighbour with one of `needs`."""
    own, holds = cells.express(tiles)
    serving, serves = cells.express(needs)
    around = [shift(cells.columns, move, -1) for move in MOVES]
    columns = np.concatenate([cells.columns, *around], -1)
    values = np.concatenate([-own, *(shift(serving, move) for move in MOVES)], -1)
    low = holds - sum(shift(serves, move) for move in MOVES)
    may = (holds > 0) | ((cells.columns >= 0) & (own != 0)).any(-1)
    return at_least(low[may], (columns[may], values[may]))


def total(
    cells: Cells,
    values: np.ndarray,
    constant: np.ndarray,
    low: float,
    high: float,
    extra: Sequence[_Term] = (),
) -> Constraints:
    """Bound a sum over all cells: of coefficients [H, W, R], constants [H, W] and extra terms."""
    columns = np.append(cells.columns.ravel(), [column for column, _ in extra]).astype(int)
    coefficients = np.append(values.ravel(), [value for _, value in extra])
    limits = (np.array([limit - constant.sum()]) for limit in (low, high))
    return Constraints(columns[None], coefficients[None], *limits)


def build(layout: np.ndarray, facts: Facts) -> Program:
    """Build the program that repairs `layout` (int8 [H, W]), connectivity left out."""
    # The base role is the allowed one with the fewest adjacency demands: its cells need no rows.
    may, demands = facts.may_take, [facts.demands[members[0]] for members in facts.roles]
    order = np.argsort(demands, kind="stable")
    base = order[may[..., order].argmax(-1)]
    binary = may & (np.arange(may.shape[-1]) != base[..., None])
    # Numbered cell by cell, so that neighbours in the grid are near in the program.
    cells = Cells(np.where(binary, np.cumsum(binary).reshape(binary.shape) - 1, -1), base)
    size = int(cells.columns.max()) + 1
    apart = [
        kind
        for members in facts.roles
        if (facts.counting[:, members].any(1) & ~facts.counting[:, members].all(1)).any()
        for kind in members
    ]
    retypes = {kind: (size + 2 * n, size + 2 * n + 1) for n, kind in enumerate(apart)}
    size += 2 * len(apart)
    wholes = []
    for rule in facts.rules.covers:
        for shape in rule.shapes:
            wholes.append(np.full(layout.shape, -1))
            height, width = np.maximum(np.subtract(layout.shape, shape) + 1, 0)
            inside = wholes[-1][:height, :width]  # where it may have its first corner
            inside[:] = size + np.arange(inside.size).reshape(inside.shape)
            size += inside.size
    lines = list[np.ndarray]()
    if facts.rules.straight:
        lines = np.split(size + np.arange(sum(layout.shape)), layout.shape[:1])
        size += sum(layout.shape)
    # At most one binary of a cell is set.
    several = binary.sum(-1) > 1
    columns = cells.columns[several][np.argsort(base[several], kind="stable")]
    rows = [
        at_least(np.full(len(columns), -1.0), (columns, -1.0)),
        *(
            demand(cells, facts.roles_of(rule.tiles), facts.roles_of(rule.needs))
            for rule in facts.rules.adjacency
        ),
        *_counts(cells, retypes, facts, layout),
        *_covers(cells, wholes, facts),
        *_straight(cells, lines, facts),
    ]
    # A row without variables matters only where fixed cells break it.
    used = [part.terms().any(1) | (part.low > 0) | (part.high < 0) for part in rows]
    rows = [Constraints(*(x[use] for x in part)) for part, use in zip(rows, used, strict=True)]
    upper, integer = np.ones(size), np.ones(size, bool)
    upper[[column for pair in retypes.values() for column in pair]] = layout.size
    # Nothing branches on rectangles and straight aisles: their cells decide what they are.
    for columns in (*wholes, *lines):
        integer[columns[columns >= 0]] = False
    cost, constant = _cost(cells, retypes, facts, layout, size)
    return Program(
        cells, cost, rows, upper, integer, constant, retypes, tuple(wholes), tuple(lines)
    )


def _counts(
    cells: Cells, retypes: dict[int, tuple[int, int]], facts: Facts, layout: np.ndarray
) -> list[Constraints]:
    """Bound the counts: of whole roles, or of kinds that are counted apart."""
    kept, rows = facts.keeps(layout), []
    for role, members in enumerate(facts.roles):
        if members[0] not in retypes:
            continue
        may = facts.rules.allowed[..., members]
        left, left_terms = np.ones(layout.shape), list[_Term]()
        # Sums over the cells with this role, which are 0 or more: weights, extra terms, limit.
        sums = list[tuple[np.ndarray, list[_Term], float]]()
        for place, kind in enumerate(members):
            # The amount of a kind is staying + gained - lost.
            (gained, lost), staying = retypes[kind], 1.0 * (kept & (layout == kind))
            sums.append((staying, [(lost, -1.0)], np.inf))
            # At least the cells that may hold no other kind of the role, at most those that may
            # hold this one.
            this = may[..., place]
            only = this & (may.sum(-1) == 1)
            if only.any():
                sums.append((staying - only, [(gained, 1.0), (lost, -1.0)], np.inf))
            if (may.any(-1) & ~this).any():
                sums.append((this - staying, [(gained, -1.0), (lost, 1.0)], np.inf))
            left = left - staying
            left_terms += [(gained, -1.0), (lost, 1.0)]
        sums.append((left, left_terms, 0.0))
        own, constant = cells.express(np.arange(len(facts.roles)) == role)
        for weights, extra, high in sums:
            values = own * weights[..., None]
            rows.append(total(cells, values, constant * weights, 0.0, high, extra))
    for bound, counting in zip(facts.rules.counts, facts.counting, strict=True):
        whole = facts.roles_of(bound.tiles)
        values, constant = cells.express(whole)
        extra = list[_Term]()
        for kind in np.flatnonzero(counting & ~whole[facts.role_of]).tolist():
            hold, holds = cells.express(np.arange(whole.size) == facts.role_of[kind])
            staying = kept & (layout == kind)
            values, constant = values + hold * staying[..., None], constant + holds * staying
            extra += zip(retypes[kind], (1.0, -1.0), strict=True)
        high = np.inf if bound.high is None else bound.high
        rows.append(total(cells, values, constant, bound.low, high, extra))
    return rows


def _covers(cells: Cells, wholes: Sequence[np.ndarray], facts: Facts) -> Iterator[Constraints]:
    """Demand a whole rectangle over each cell, and the tiles on all cells of a whole one."""
    several = iter(wholes)
    for rule, exempt in zip(facts.rules.covers, facts.exempt, strict=True):
        own, holds = cells.express(facts.roles_of(rule.tiles))
        end, drives = cells.express(facts.roles_of(rule.ends))
        over = []
        for shape in rule.shapes:
            columns = next(several)
            corners, offsets = np.argwhere(columns >= 0), np.argwhere(np.ones(shape))
            rows, cols = (corners[:, None] + offsets).reshape(-1, 2).T
            whole = np.repeat(columns[columns >= 0], len(offsets))
            inner = rule.inner(shape).ravel()
            inside = np.tile(inner, len(corners))
            terms = np.where(inside[:, None], own[rows, cols], end[rows, cols])
            constant = np.where(inside, holds[rows, cols], drives[rows, cols])
            yield at_least(-constant, (cells.columns[rows, cols], terms), (whole, -1.0))
            padded = np.pad(columns, [(side - 1, 0) for side in shape], constant_values=-1)
            windows = np.lib.stride_tricks.sliding_window_view(padded, shape)
            over.append(windows.reshape(columns.size, -1)[~exempt.ravel()][:, inner])
        columns, terms = cells.columns[~exempt], own[~exempt]
        yield at_least(holds[~exempt], (np.hstack(over), 1.0), (columns, -terms))


def _straight(cells: Cells, lines: Sequence[np.ndarray], facts: Facts) -> Iterator[Constraints]:
    """Demand no tiles in straight aisles, and one aisle among any `most` + 1 lines."""
    tiles, most = facts.rules.straight or ("", 0)
    (own, holds), may = cells.express(facts.roles_of(tiles)), facts.may(tiles)
    for axis, columns in enumerate(lines):
        line = np.broadcast_to(columns[:, None] if axis == 0 else columns, may.shape)[may]
        yield at_least(holds[may] - 1.0, (cells.columns[may], -own[may]), (line, -1.0))
        if len(columns) > most:
            windows = np.lib.stride_tricks.sliding_window_view(columns, most + 1)
            yield at_least(np.ones(len(windows)), (windows, 1.0))


def _cost(
    cells: Cells, retypes: dict[int, tuple[int, int]], facts: Facts, layout: np.ndarray, size: int
) -> tuple[np.ndarray, float]:
    """Price what is not kept; a kind that leaves its cell to another costs its cheapest cell."""
    kept, roles = facts.keeps(layout), np.arange(len(facts.roles))
    change_cost = np.asarray(facts.rules.change_cost, np.float64)
    stays = kept[..., None] & (facts.role_of[layout][..., None] == roles)
    price = change_cost[..., None] * ~stays
    rises = price - np.take_along_axis(price, cells.base[..., None], -1)
    cost, used = np.zeros(size), cells.columns >= 0
    cost[cells.columns[used]] = rises[used]
    for kind, (_, lost) in retypes.items():
        costs = change_cost[kept & (layout == kind)]
        cost[lost] = costs.min() if costs.size else 0.0
    # Role by role and cell by cell: the order of a sum decides its last bit.
    constant = 0.0
    for role in roles:
        constant += np.cumsum(price[..., role] * (cells.base == role))[-1]
    return cost, float(constant)


def encode(program: Program, candidate: np.ndarray, layout: np.ndarray, facts: Facts) -> np.ndarray:
    """Express a feasible `candidate` (int8 [H, W]) for the input `layout` as variables' values."""
    values, role = np.zeros(program.cost.size), facts.role_of[candidate]
    column = np.take_along_axis(program.cells.columns, role[..., None], -1)
    values[column[column >= 0]] = 1.0
    kept = facts.keeps(layout)
    for kind, (gained, lost) in program.retypes.items():
        other = (role == facts.role_of[kind]) & (candidate != kind)
        values[gained] = ((candidate == kind) & ~(kept & (candidate == layout))).sum()
        values[lost] = (kept & (layout == kind) & other).sum()
    pairs = [(rule, shape) for rule in facts.rules.covers for shape in rule.shapes]
    for columns, (rule, shape) in zip(program.wholes, pairs, strict=True):
        padding = [(0, side - 1) for side in shape]
        views = [
            np.lib.stride_tricks.sliding_window_view(np.pad(holds[candidate], padding), shape)
            for holds in (facts.holding(rule.tiles), facts.holding(rule.ends))
        ]
        whole = np.where(rule.inner(shape), *views).all((-1, -2))
        values[columns[whole]] = 1.0
    for axis, columns in enumerate(program.lines):
        tiles, _ = facts.rules.straight or ("", 0)
        values[columns[~facts.holding(tiles)[candidate].any(1 - axis)]] = 1.0
    return values


def decode(cells: Cells, values: np.ndarray) -> np.ndarray:
    """Read each cell's role from a solution (int64 [H, W])."""
    holds = np.append(values, 0.0)[cells.columns]  # column -1 is the 0 at the end
    # What the binaries leave over is the base role's, of fixed cells all of it.
    rows, cols = np.nonzero(cells.base >= 0)
    holds[rows, cols, cells.base[rows, cols]] = 1.0 - holds[rows, cols].sum(-1)
    return np.asarray(holds.argmax(-1))
