"""The variables of the repair program, and columns of expressions in them."""

from typing import NamedTuple

import numpy as np
from scipy import sparse

from qdenv.repair.rules import Facts


class Affine(NamedTuple):
    """A column of expressions ``matrix @ v + offset`` in the variables v."""

    matrix: sparse.csr_array  # float64 [expressions, variables], sparse
    offset: np.ndarray  # float64 [expressions]

    def plus(self, other: "Affine") -> "Affine":
        """Add a column of equal length."""
        return Affine(sparse.csr_array(self.matrix + other.matrix), self.offset + other.offset)

    def minus(self, other: "Affine") -> "Affine":
        """Subtract a column of equal length."""
        return Affine(sparse.csr_array(self.matrix - other.matrix), self.offset - other.offset)

    def combined(self, weights: sparse.sparray | np.ndarray) -> "Affine":
        """Combine the expressions: ``weights @ self``, weights [rows, cells] or [cells]."""
        weights = weights if sparse.issparse(weights) else sparse.csr_array(np.atleast_2d(weights))
        return Affine(sparse.csr_array(weights @ self.matrix), weights @ self.offset)

    def at(self, cells: np.ndarray) -> "Affine":
        """Select expressions."""
        return Affine(self.matrix[cells], self.offset[cells])


class Retype(NamedTuple):
    """Two integers of a kind that is counted apart from the others of its role."""

    gained: int  # column of the number of cells that become it
    lost: int  # column of the number of its input cells that keep the role but not the kind


class Variables(NamedTuple):
    """Where each variable stands."""

    total: int  # how many there are
    first_role: np.ndarray  # int64 [cells], the role a cell holds when none of its binaries is set
    # int64 [roles, cells], column of the binary "the cell holds the role", or -1
    binaries: np.ndarray
    retypes: dict[int, Retype]  # kind -> its two integers
    squares: np.ndarray  # int64 [H, W], column of the aisle square that starts here, or -1
    holds: list[Affine]  # per role, one expression per cell: 1 where the cell holds the role

    def group(self, facts: Facts, tiles: str) -> Affine:
        """Express which cells hold one of `tiles`, a union of roles."""
        hold = Affine(self.holds[0].matrix * 0, self.holds[0].offset * 0)
        for members, of_role in zip(facts.roles, self.holds, strict=True):
            if facts.rules.tiles[members[0]] in tiles:
                hold = hold.plus(of_role)
        return hold

    def unit(self, column: int) -> Affine:
        """Express one variable."""
        matrix = sparse.csr_array(([1.0], ([0], [column])), shape=(1, self.total))
        return Affine(matrix, np.zeros(1))

    def zero(self) -> Affine:
        """Express the number zero."""
        return Affine(sparse.csr_array((1, self.total)), np.zeros(1))


def number_variables(facts: Facts) -> Variables:
    """Number all variables: the cells' binaries, then retypes, then aisle squares."""
    first_role, binaries = _number_binaries(facts)
    total = int(binaries.max()) + 1
    retypes = _number_retypes(facts, total)
    total += 2 * len(retypes)
    squares, total = _number_squares(facts, total)
    holds = [
        _hold_role(binaries, first_role == role, role, total) for role in range(len(facts.roles))
    ]
    return Variables(total, first_role, binaries, retypes, squares, holds)


def _number_binaries(facts: Facts) -> tuple[np.ndarray, np.ndarray]:
    """Choose each cell's first role and number the binaries of the others.

    The first role is the allowed one with the fewest adjacency demands: its cells need no rows.
    """
    allowed = facts.rules.allowed.reshape(-1, len(facts.rules.tiles))
    may = np.array([allowed[:, members].any(1) for members in facts.roles])
    order = np.argsort([facts.demands[members[0]] for members in facts.roles], kind="stable")
    first_role = order[may[order].argmax(0)]
    wanted = may & (np.arange(len(facts.roles))[:, None] != first_role)
    # Numbered cell by cell, so that neighbours in the grid are near in the program.
    number = np.cumsum(wanted.T).reshape(wanted.T.shape).T - 1
    return first_role, np.where(wanted, number, -1)


def _number_retypes(facts: Facts, total: int) -> dict[int, Retype]:
    """Number two integers for each kind that a bound tells apart from others of its role."""
    apart = [
        kind
        for members in facts.roles
        if (facts.counting[:, members].any(1) & ~facts.counting[:, members].all(1)).any()
        for kind in members
    ]
    return {kind: Retype(total + 2 * n, total + 2 * n + 1) for n, kind in enumerate(apart)}


def _number_squares(facts: Facts, total: int) -> tuple[np.ndarray, int]:
    """Number one variable per aisle square; returns the new total as well."""
    squares, aisle = np.full(facts.free.shape, -1), facts.rules.aisle
    if aisle > 1:
        inside = squares[: 1 - aisle, : 1 - aisle]
        inside[:] = total + np.arange(inside.size).reshape(inside.shape)
        total += inside.size
    return squares, total


def _hold_role(binaries: np.ndarray, first: np.ndarray, role: int, total: int) -> Affine:
    """Express which cells hold `role`: its binary, or what no other binary took."""
    own = np.flatnonzero(binaries[role] >= 0)
    others, taken = np.nonzero(first & (binaries >= 0))
    rows = np.concatenate([own, taken])
    columns = np.concatenate([binaries[role, own], binaries[others, taken]])
    values = np.repeat([1.0, -1.0], [own.size, taken.size])
    matrix = sparse.csr_array((values, (rows, columns)), shape=(first.size, total))
    return Affine(matrix, first.astype(float))


class Program(NamedTuple):
    """Minimise ``cost @ v + constant``, ``0 <= v <= upper``, ``low <= rows @ v <= high``."""

    variables: Variables  # where each variable v stands
    cost: np.ndarray  # float64 [variables]
    constant: float  # cost when all variables are 0
    upper: np.ndarray  # float64 [variables]
    integer: np.ndarray  # bool [variables]
    rows: sparse.csr_array  # float64 [rows, variables], sparse
    low: np.ndarray  # float64 [rows]
    high: np.ndarray  # float64 [rows]


class Block(NamedTuple):
    """Rows ``low <= expressions <= high``."""

    expressions: Affine
    low: float
    high: float


def build(layout: np.ndarray, facts: Facts) -> Program:
    """Build the program that repairs `layout` (int8 [H, W]), connectivity left out."""
    variables = number_variables(facts)
    blocks = [
        _one_role(variables),
        *_adjacency(facts, variables),
        *_counts(facts, variables, layout),
        *_aisles(facts, variables),
    ]
    cost = _cost(facts, variables, layout)
    upper, integer = np.ones(variables.total), np.ones(variables.total, bool)
    upper[[column for pair in variables.retypes.values() for column in pair]] = layout.size
    # A square is open when its cells are: no need to branch on it.
    integer[variables.squares[variables.squares >= 0]] = False
    rows = sparse.csr_array(sparse.vstack([block.expressions.matrix for block in blocks]))
    low, high = (
        np.concatenate([side - expressions.offset for expressions, side in pairs])
        for pairs in (
            [(block.expressions, block.low) for block in blocks],
            [(block.expressions, block.high) for block in blocks],
        )
    )
    # A row without variables says something only where fixed cells break it.
    used = (np.diff(rows.indptr) > 0) | (low > 0) | (high < 0)
    return Program(
        variables=variables,
        cost=cost.matrix.toarray()[0],
        constant=float(cost.offset[0]),
        upper=upper,
        integer=integer,
        rows=rows[used],
        low=low[used],
        high=high[used],
    )


def _one_role(variables: Variables) -> Block:
    """At most one binary of a cell is set."""
    cells = np.flatnonzero((variables.binaries >= 0).sum(0) > 1)
    first = variables.first_role[cells]
    left = [hold.at(cells[first == role]) for role, hold in enumerate(variables.holds)]
    matrix = sparse.csr_array(sparse.vstack([hold.matrix for hold in left]))
    return Block(Affine(matrix, np.concatenate([hold.offset for hold in left])), 0.0, np.inf)


def _neighbours(height: int, width: int) -> sparse.csr_array:
    """Build the 4-neighbourhood of a grid (float64 [cells, cells])."""
    down, right = (sparse.eye_array(n, k=1) + sparse.eye_array(n, k=-1) for n in (height, width))
    along_columns = sparse.kron(down, sparse.eye_array(width))
    return sparse.csr_array(along_columns + sparse.kron(sparse.eye_array(height), right))


def _adjacency(facts: Facts, variables: Variables) -> list[Block]:
    """A tile is at most as often in a cell as what it needs is around it."""
    around = _neighbours(*facts.free.shape)
    blocks = []
    for rule in facts.rules.adjacency:
        tiles = variables.group(facts, rule.tiles)
        may = np.flatnonzero((np.diff(tiles.matrix.indptr) > 0) | (tiles.offset > 0))
        needs = variables.group(facts, rule.needs).combined(around)
        blocks.append(Block(needs.minus(tiles).at(may), 0.0, np.inf))
    return blocks


def _retyped_amounts(
    facts: Facts, variables: Variables, layout: np.ndarray
) -> tuple[dict[int, Affine], list[Block]]:
    """Express the amount of each kind counted apart: those kept, less those lost, plus the new."""
    kept, layout = facts.keeps(layout).ravel(), layout.ravel()
    amounts: dict[int, Affine] = {}
    blocks = []
    for members, hold in zip(facts.roles, variables.holds, strict=True):
        if members[0] not in variables.retypes:
            continue
        difference = hold.combined(np.ones(layout.size))
        for kind in members:
            gained, lost = (variables.unit(column) for column in variables.retypes[kind])
            staying = hold.combined((kept & (layout == kind)).astype(float))
            amounts[kind] = staying.plus(gained).minus(lost)
            blocks.append(Block(staying.minus(lost), 0.0, np.inf))
            blocks += _settled(facts, hold, amounts[kind], kind, members)
            difference = difference.minus(amounts[kind])
        blocks.append(Block(difference, 0.0, 0.0))
    return amounts, blocks


def _settled(
    facts: Facts, hold: Affine, amount: Affine, kind: int, members: list[int]
) -> list[Block]:
    """Bound the amount of a kind by the cells that may hold it, or no other kind of its role."""
    may = facts.rules.allowed[..., members].reshape(-1, len(members))
    this = may[:, members.index(kind)]
    only = this & (may.sum(1) == 1)
    blocks = []
    if only.any():
        blocks.append(Block(amount.minus(hold.combined(only.astype(float))), 0.0, np.inf))
    if (may.any(1) & ~this).any():
        blocks.append(Block(hold.combined(this.astype(float)).minus(amount), 0.0, np.inf))
    return blocks


def _counts(facts: Facts, variables: Variables, layout: np.ndarray) -> list[Block]:
    """Bound the counts: of whole roles, or of kinds that are counted apart."""
    amounts, blocks = _retyped_amounts(facts, variables, layout)
    for bound, counting in zip(facts.rules.counts, facts.counting, strict=True):
        amount = variables.zero()
        for members, hold in zip(facts.roles, variables.holds, strict=True):
            if counting[members].all():
                amount = amount.plus(hold.combined(np.ones(layout.size)))
                continue
            for kind in members:
                if counting[kind]:
                    amount = amount.plus(amounts[kind])
        blocks.append(Block(amount, bound.low, np.inf if bound.high is None else bound.high))
    return blocks


def _aisles(facts: Facts, variables: Variables) -> list[Block]:
    """A driving cell needs an aisle square over it; a square needs all its cells to drive."""
    side, squares = facts.rules.aisle, variables.squares
    if side <= 1:
        return []
    driving = variables.group(facts, facts.rules.connected)
    cells = np.arange(squares.size).reshape(squares.shape)
    pairs = np.array(
        [
            (squares[row, col], cells[row + down, col + right])
            for row, col in np.argwhere(squares >= 0)
            for down in range(side)
            for right in range(side)
        ]
    )
    ones, shape = np.ones(len(pairs)), (len(pairs), variables.total)
    square = sparse.csr_array((ones, (np.arange(len(pairs)), pairs[:, 0])), shape=shape)
    shape = (squares.size, variables.total)
    over = sparse.csr_array((ones, (pairs[:, 1], pairs[:, 0])), shape=shape)
    return [
        Block(driving.at(pairs[:, 1]).minus(Affine(square, np.zeros(len(pairs)))), 0.0, np.inf),
        Block(Affine(over, np.zeros(squares.size)).minus(driving), 0.0, np.inf),
    ]


def _cost(facts: Facts, variables: Variables, layout: np.ndarray) -> Affine:
    """Price what is not kept; a kind that leaves its cell to another costs its cheapest cell."""
    kept, layout = facts.keeps(layout).ravel(), layout.ravel()
    change_cost = np.asarray(facts.rules.change_cost, np.float64).ravel()
    cost = variables.zero()
    for members, hold in zip(facts.roles, variables.holds, strict=True):
        cost = cost.plus(hold.combined(change_cost * ~(kept & np.isin(layout, members))))
    for kind, (_, lost) in variables.retypes.items():
        costs = change_cost[kept & (layout == kind)]
        cheapest = float(costs.min()) if costs.size else 0.0
        cost = cost.plus(variables.unit(lost).combined(np.array([cheapest])))
    return cost


def encode(program: Program, candidate: np.ndarray, layout: np.ndarray, facts: Facts) -> np.ndarray:
    """Express a feasible `candidate` (int8 [H, W]) for the input `layout` as variables' values."""
    variables, driving = program.variables, facts.driving[candidate]
    kept, layout, candidate = facts.keeps(layout).ravel(), layout.ravel(), candidate.ravel()
    values = np.zeros(variables.total)
    for members, hold in zip(facts.roles, variables.holds, strict=True):
        plus = sparse.coo_array(hold.matrix)
        chosen = np.isin(candidate, members)[plus.row] & (plus.data > 0)
        values[plus.col[chosen]] = 1.0
    for kind, (gained, lost) in variables.retypes.items():
        members = facts.roles[facts.role_of[kind]]
        retyped = np.isin(candidate, members) & (candidate != kind)
        values[gained] = ((candidate == kind) & ~(kept & (candidate == layout))).sum()
        values[lost] = (kept & (layout == kind) & retyped).sum()
    side = facts.rules.aisle
    if side > 1:
        whole = np.lib.stride_tricks.sliding_window_view(driving, (side, side)).all((-1, -2))
        values[variables.squares[: 1 - side, : 1 - side][whole]] = 1.0
    return values


def decode(program: Program, values: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Read each cell's role from a solution (int64 [H, W])."""
    holds = [hold.matrix @ values + hold.offset for hold in program.variables.holds]
    return np.argmax(holds, axis=0).reshape(shape)
