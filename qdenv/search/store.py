"""One store of solutions for several archives, which refer to its rows.

A solution that two archives hold is stored once, and a search with few elites stores little.
Reading a checkpoint needs this file, but not qdax, which takes a second to import.
"""

import math
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import jax
import jax.numpy as jnp

if TYPE_CHECKING:
    from qdenv.search.archive import GridArchive

ROW = jax.ShapeDtypeStruct((), jnp.int32)  # what an archive holds in place of a solution


class Store(NamedTuple):
    """Solutions by row, and which rows are free.

    Row 0 is what empty cells refer to: zeros, never handed out.
    """

    cells: jax.Array  # int32 [R], the cell that each row was last written for
    used: jax.Array  # bool [R], whether an archive refers to the row
    solutions: jax.Array  # float [R, P]

    @classmethod
    def empty(cls, solution: jax.Array, batch: int, *archives: "GridArchive") -> Self:
        """Make a store of solutions like `solution` (float [P]) with free rows for every batch."""
        # An archive refers to at most one row for each of its cells.
        rows = 1 + batch + sum(math.prod(axis.cells for axis in a.measures) for a in archives)
        blank = jnp.zeros((rows, *solution.shape), solution.dtype)
        return cls(jnp.zeros(rows, jnp.int32), jnp.arange(rows) == 0, blank)

    def free_rows(self, count: int) -> jax.Array:
        """List `count` free rows, int32 [count]; there must be that many."""
        # XLA has a fast partial sort on CPUs for float32 alone; of equals the first come first.
        return jax.lax.top_k((~self.used).astype(jnp.float32), count)[1]

    def write(
        self, rows: jax.Array, solutions: jax.Array, cells: jax.Array, *archives: "GridArchive"
    ) -> Self:
        """Write the solutions that an archive took in, and free rows that no archive refers to.

        `rows` (int32 [B]) come from `free_rows`, `cells` are int32 [B]; `archives` are all that
        refer to this store, after the batch.
        """
        written_for = self.cells.at[rows].set(cells)
        index = jnp.arange(len(self.used))
        # A row can only be referred to by the cell it was written for: one look-up suffices.
        used = index == 0
        for archive in archives:
            used |= archive.genotypes[written_for] == index
        target = jnp.where(used[rows], rows, len(self.used))  # others: out of bounds
        written = self.solutions.at[target].set(solutions, mode="drop")
        return self._replace(cells=written_for, used=used, solutions=written)

    def resized(self, rows: int) -> Self:
        """Cut or lengthen the store to `rows`; rows cut off must be free."""

        def fit(leaf: jax.Array) -> jax.Array:
            longer = [(0, max(rows - len(leaf), 0))] + [(0, 0)] * (leaf.ndim - 1)
            return jnp.pad(leaf[:rows], longer)

        return jax.tree.map(fit, self)


def is_store(node: Any) -> bool:
    """Return True for a store, to stop at when walking the tree of a state."""
    return isinstance(node, Store)


def stores_in(state: Any) -> list[Store]:
    """List the stores in the state of a search."""
    return [node for node in jax.tree.leaves(state, is_leaf=is_store) if is_store(node)]
