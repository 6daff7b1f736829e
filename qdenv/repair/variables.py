"""The variables of the repair program, and columns of expressions in them."""

from typing import NamedTuple

import numpy as np
from scipy import sparse

from qdenv.types import Rules


class Affine(NamedTuple):
    """A column of expressions ``matrix @ v + offset`` in the variables v."""

    matrix: sparse.csr_array
    offset: np.ndarray

    def __add__(self, other: "Affine") -> "Affine":
        """Add two columns of equal length."""
        return Affine(sparse.csr_array(self.matrix + other.matrix), self.offset + other.offset)

    def __sub__(self, other: "Affine") -> "Affine":
        """Subtract a column of equal length."""
        return Affine(sparse.csr_array(self.matrix - other.matrix), self.offset - other.offset)

    def combined(self, weights: sparse.sparray | np.ndarray) -> "Affine":
        """Combine the expressions: ``weights @ self``, weights [rows, cells] or [cells]."""
        weights = weights if sparse.issparse(weights) else sparse.csr_array(np.atleast_2d(weights))
        return Affine(sparse.csr_array(weights @ self.matrix), weights @ self.offset)

    def __getitem__(self, cells: np.ndarray) -> "Affine":
        """Select expressions."""
        return Affine(self.matrix[cells], self.offset[cells])


def neighbours(height: int, width: int) -> sparse.csr_array:
    """Build the 4-neighbourhood of a grid (float64 [cells, cells])."""
    down, right = (sparse.eye_array(n, k=1) + sparse.eye_array(n, k=-1) for n in (height, width))
    along_columns = sparse.kron(down, sparse.eye_array(width))
    return sparse.csr_array(along_columns + sparse.kron(sparse.eye_array(height), right))


def place_binaries(rules: Rules, roles: list[list[int]]) -> tuple[np.ndarray, np.ndarray]:
    """Choose each cell's first role (int64 [cells]) and number the binaries of the others.

    The first role is the allowed one with the fewest adjacency demands: its cells need no rows.
    Binaries are int64 [roles, cells], -1 where there is none.
    """
    allowed = rules.allowed.reshape(-1, len(rules.tiles))
    may = np.array([allowed[:, members].any(1) for members in roles])
    demands = [
        sum(rules.tiles[role[0]] in rule.tiles for rule in rules.adjacency) for role in roles
    ]
    order = np.argsort(demands, kind="stable")
    first = order[may[order].argmax(0)]
    wanted = may & (np.arange(len(roles))[:, None] != first)
    # Numbered cell by cell, so that neighbours in the grid are near in the program.
    number = np.cumsum(wanted.T).reshape(wanted.T.shape).T - 1
    return first, np.where(wanted, number, -1)


def place_retypes(
    rules: Rules, roles: list[list[int]], total: int
) -> tuple[dict[int, tuple[int, int]], int]:
    """Number two integers for each kind that is counted apart from the others of its role."""
    retype = {}
    for members in roles:
        names = {rules.tiles[kind] for kind in members}
        if any(0 < len(names & set(bound.tiles)) < len(names) for bound in rules.counts):
            for kind in members:
                retype[kind] = (total, total + 1)
                total += 2
    return retype, total


def place_squares(rules: Rules, total: int) -> tuple[np.ndarray, int]:
    """Number one variable per aisle square."""
    squares = np.full(rules.allowed.shape[:2], -1)
    if rules.aisle > 1:
        inside = squares[: 1 - rules.aisle, : 1 - rules.aisle]
        inside[:] = total + np.arange(inside.size).reshape(inside.shape)
        total += inside.size
    return squares, total


def hold_role(column: np.ndarray, base: np.ndarray, role: int, total: int) -> Affine:
    """Express which cells hold `role`: its binary, or what no other binary took."""
    roles, cells = column.shape
    matrix = sparse.lil_array((cells, total))
    own = np.flatnonzero(column[role] >= 0)
    matrix[own, column[role, own]] = 1.0
    for other in range(roles):
        taken = np.flatnonzero(base & (column[other] >= 0))
        matrix[taken, column[other, taken]] = -1.0
    return Affine(sparse.csr_array(matrix), base.astype(float))


def unit(column: int, total: int) -> Affine:
    """Express one variable."""
    return Affine(sparse.csr_array(([1.0], ([0], [column])), shape=(1, total)), np.zeros(1))
