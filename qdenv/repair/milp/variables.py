"""The variables of the repair program, and columns of expressions in them."""

from typing import NamedTuple

import numpy as np
from scipy import sparse

from qdenv.repair.facts import Facts


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
