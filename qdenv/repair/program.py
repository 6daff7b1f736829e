"""The repair as an integer program, built from the same rules the annealer and the audit read.

One binary per cell and role (tiles that no rule tells apart share a role: the three kinds of
station are one); a cell's first role is what is left when no binary is set. Which kind a new tile
of a role becomes is a handful of integers here, and is handed out afterwards (`kinds`).
Connectivity is not in the program: `cuts` adds it where a solution breaks it.
"""

from typing import NamedTuple

import numpy as np
from scipy import sparse

from qdenv.repair.board import group_roles
from qdenv.repair.variables import (
    Affine,
    hold_role,
    neighbours,
    place_binaries,
    place_retypes,
    place_squares,
    unit,
)
from qdenv.types import Rules


class Program(NamedTuple):
    """Minimise ``cost @ v + constant`` over ``0 <= v <= top`` with ``low <= rows @ v <= high``."""

    roles: list[list[int]]
    holds: list[Affine]  # per role, one expression per cell: 1 where the cell holds the role
    retype: dict[int, tuple[int, int]]  # kind -> columns: cells that become it, cells that leave it
    squares: np.ndarray  # int64 [H, W], column of the aisle square that starts here, or -1
    cost: np.ndarray
    constant: float
    top: np.ndarray
    integer: np.ndarray
    rows: sparse.csr_array
    low: np.ndarray
    high: np.ndarray


def build(layout: np.ndarray, rules: Rules) -> Program:
    """Build the program that repairs `layout` (int8 [H, W]), connectivity left out."""
    roles = group_roles(rules)
    first, column = place_binaries(rules, roles)
    total = int(column.max()) + 1
    retype, total = place_retypes(rules, roles, total)
    squares, total = place_squares(rules, total)
    holds = [hold_role(column, first == role, role, total) for role in range(len(roles))]
    kept = _kept(layout, rules)
    blocks = [
        _one_role(holds, first, column),
        *_adjacency(rules, roles, holds),
        *_counts(rules, roles, holds, retype, layout, kept, total),
        *_aisles(rules, roles, holds, squares, total),
    ]
    price = _price(rules, layout, roles, holds, retype, kept, total)
    top, integer = np.ones(total), np.ones(total, bool)
    top[[place for pair in retype.values() for place in pair]] = layout.size
    integer[squares[squares >= 0]] = False
    rows = sparse.csr_array(sparse.vstack([block[0].matrix for block in blocks]))
    shift = np.concatenate([block[0].offset for block in blocks])
    low = np.concatenate([np.full(block[0].offset.size, block[1]) for block in blocks]) - shift
    high = np.concatenate([np.full(block[0].offset.size, block[2]) for block in blocks]) - shift
    used = np.diff(rows.indptr) > 0  # a row without variables is the audit's business
    return Program(
        roles=roles,
        holds=holds,
        retype=retype,
        squares=squares,
        cost=price.matrix.toarray()[0],
        constant=float(price.offset[0]),
        top=top,
        integer=integer,
        rows=rows[used],
        low=low[used],
        high=high[used],
    )


def _kept(layout: np.ndarray, rules: Rules) -> np.ndarray:
    """Mark cells that may keep their input tile (bool [cells])."""
    rows, cols = np.indices(layout.shape)
    return rules.allowed[rows, cols, layout].ravel()


def _one_role(
    holds: list[Affine], first: np.ndarray, column: np.ndarray
) -> tuple[Affine, float, float]:
    """At most one binary of a cell is set."""
    cells = np.flatnonzero((column >= 0).sum(0) > 1)
    bases = [hold[cells[first[cells] == role]] for role, hold in enumerate(holds)]
    matrix = sparse.csr_array(sparse.vstack([base.matrix for base in bases]))
    return Affine(matrix, np.concatenate([base.offset for base in bases])), 0.0, np.inf


def group_tiles(rules: Rules, roles: list[list[int]], holds: list[Affine], tiles: str) -> Affine:
    """Express which cells hold one of `tiles`, a union of roles."""
    chosen = [
        hold for members, hold in zip(roles, holds, strict=True) if rules.tiles[members[0]] in tiles
    ]
    zero = Affine(holds[0].matrix * 0, holds[0].offset * 0)
    return sum(chosen, start=zero)


def _adjacency(rules: Rules, roles: list[list[int]], holds: list[Affine]) -> list:
    """A tile is at most as often in a cell as what it needs is around it."""
    around = neighbours(*rules.allowed.shape[:2])
    blocks = []
    for rule in rules.adjacency:
        tiles = group_tiles(rules, roles, holds, rule.tiles)
        may = np.flatnonzero((np.diff(tiles.matrix.indptr) > 0) | (tiles.offset > 0))
        needs = group_tiles(rules, roles, holds, rule.needs).combined(around)
        blocks.append(((needs - tiles)[may], 0.0, np.inf))
    return blocks


def _counts(rules, roles, holds, retype, layout, kept, total) -> list:
    """Bound the counts; kinds counted apart are those kept, less those lost, plus the new ones."""
    home, blocks = np.where(kept, layout.ravel(), -1), []
    amounts: dict[int, Affine] = {}
    for members, hold in zip(roles, holds, strict=True):
        if members[0] not in retype:
            continue
        for kind in members:
            staying = hold.combined((home == kind).astype(float))
            amounts[kind] = staying + unit(retype[kind][0], total) - unit(retype[kind][1], total)
            blocks.append((staying - unit(retype[kind][1], total), 0.0, np.inf))
        difference = hold.combined(np.ones(home.size))
        for kind in members:
            difference = difference - amounts[kind]
        blocks.append((difference, 0.0, 0.0))
    for bound in rules.counts:
        amount = Affine(sparse.csr_array((1, total)), np.zeros(1))
        for members, hold in zip(roles, holds, strict=True):
            inside = [kind for kind in members if rules.tiles[kind] in bound.tiles]
            if len(inside) == len(members):
                amount = amount + hold.combined(np.ones(home.size))
            else:
                amount = sum((amounts[kind] for kind in inside), start=amount)
        blocks.append((amount, bound.low, np.inf if bound.high is None else bound.high))
    return blocks


def _aisles(rules, roles, holds, squares, total) -> list:
    """A driving cell needs an aisle square over it; a square needs all its cells to drive."""
    if rules.aisle <= 1:
        return []
    drives = group_tiles(rules, roles, holds, rules.connected)
    corners, cells = np.argwhere(squares >= 0), np.arange(squares.size).reshape(squares.shape)
    pairs = np.array(
        [
            (squares[row, col], cells[row + down, col + right])
            for row, col in corners
            for down in range(rules.aisle)
            for right in range(rules.aisle)
        ]
    )
    square = sparse.csr_array(
        (np.ones(len(pairs)), (np.arange(len(pairs)), pairs[:, 0])), shape=(len(pairs), total)
    )
    over = sparse.csr_array(
        (np.ones(len(pairs)), (pairs[:, 1], pairs[:, 0])), shape=(squares.size, total)
    )
    return [
        (drives[pairs[:, 1]] - Affine(square, np.zeros(len(pairs))), 0.0, np.inf),
        (Affine(over, np.zeros(squares.size)) - drives, 0.0, np.inf),
    ]


def _price(rules, layout, roles, holds, retype, kept, total) -> Affine:
    """Price what is not kept; a kind that leaves its cell to another costs its cheapest cell."""
    home, weights = layout.ravel(), np.asarray(rules.change_cost, np.float64).ravel()
    price = Affine(sparse.csr_array((1, total)), np.zeros(1))
    for members, hold in zip(roles, holds, strict=True):
        price = price + hold.combined(weights * ~(kept & np.isin(home, members)))
    for kind, (_, lost) in retype.items():
        own = weights[kept & (home == kind)]
        cheapest = float(own.min()) if own.size else 0.0
        price = price + unit(lost, total).combined(np.array([cheapest]))
    return price


def encode(program: Program, layout: np.ndarray, rules: Rules, home: np.ndarray) -> np.ndarray:
    """Express a feasible `layout` (int8 [H, W]) for the input `home` as values of the variables."""
    values = np.zeros(program.cost.size)
    flat = layout.ravel()
    for members, hold in zip(program.roles, program.holds, strict=True):
        own = np.isin(flat, members)
        plus = sparse.coo_array(hold.matrix)
        chosen = own[plus.row] & (plus.data > 0)
        values[plus.col[chosen]] = 1.0
    stays = _kept(home, rules) & (flat == home.ravel())
    for members in program.roles:
        for kind in members:
            if kind in program.retype:
                new, lost = program.retype[kind]
                mine = _kept(home, rules) & (home.ravel() == kind)
                values[new] = ((flat == kind) & ~stays).sum()
                values[lost] = (mine & np.isin(flat, members) & (flat != kind)).sum()
    if rules.aisle > 1:
        drives = np.isin(np.array(list(rules.tiles))[layout], list(rules.connected))
        side = rules.aisle
        whole = np.lib.stride_tricks.sliding_window_view(drives, (side, side)).all((-1, -2))
        inside = program.squares[: 1 - side, : 1 - side]
        values[inside[whole]] = 1.0
    return values


def decode(program: Program, values: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Read each cell's role from a solution (int64 [H, W])."""
    holds = [hold.matrix @ values + hold.offset for hold in program.holds]
    return np.argmax(holds, axis=0).reshape(shape)
