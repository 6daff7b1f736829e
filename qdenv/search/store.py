"""One store of solutions for several archives, which refer to its rows.

A solution that two archives keep is held once, and a search that has found little holds little: a
store may be as small as what is in it (`qdenv.search.growth`).
"""

import math
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import jax
import jax.numpy as jnp

if TYPE_CHECKING:  # whoever reads a checkpoint needs no qdax, which takes a second to import
    from qdenv.search.archive import GridArchive

ROW = jax.ShapeDtypeStruct((), jnp.int32)  # what an archive holds in place of a solution


class Store(NamedTuple):
    """Solutions by row, and which rows are free.

    Row 0 is what empty cells refer to: zeros, never given away.
    """

    cells: jax.Array  # int32 [R], the cell that each row was last kept for
    used: jax.Array  # bool [R], whether an archive refers to the row
    solutions: jax.Array  # float [R, P]

    @classmethod
    def empty(cls, solution: jax.Array, batch: int, *archives: "GridArchive") -> Self:
        """Make a store that always has room for a batch.

        Args:
            solution: one example, float [P].
            batch: solutions of every iteration.
            archives: those that will refer to it; each has at most one row for each of its cells.
        """
        rows = 1 + batch + sum(math.prod(axis.cells for axis in a.measures) for a in archives)
        blank = jnp.zeros((rows, *solution.shape), solution.dtype)
        return cls(jnp.zeros(rows, jnp.int32), jnp.arange(rows) == 0, blank)

    def free_rows(self, count: int) -> jax.Array:
        """List `count` free rows, int32 [count]; there must be as many."""
        # XLA has a fast partial sort on CPUs for float32 alone; of equals the first come first.
        return jax.lax.top_k((~self.used).astype(jnp.float32), count)[1]

    def keep(
        self, rows: jax.Array, solutions: jax.Array, cells: jax.Array, *archives: "GridArchive"
    ) -> Self:
        """Write the solutions that an archive took in, and free what no archive refers to.

        Args:
            rows: int32 [B], from `free_rows`.
            solutions: float [B, P].
            cells: int32 [B].
            archives: all that refer to this store, after the batch.
        """
        kept_for = self.cells.at[rows].set(cells)
        everyone = jnp.arange(len(self.used))
        # A row can only be referred to by the cell it was kept for: one look-up tells.
        used = everyone == 0
        for archive in archives:
            used |= archive.genotypes[kept_for] == everyone
        target = jnp.where(used[rows], rows, len(self.used))  # others: out of bounds
        written = self.solutions.at[target].set(solutions, mode="drop")
        return self._replace(cells=kept_for, used=used, solutions=written)

    def resized(self, rows: int) -> Self:
        """Cut or lengthen the store to `rows`; rows cut off must be free."""

        def fit(leaf: jax.Array) -> jax.Array:
            longer = [(0, max(rows - len(leaf), 0))] + [(0, 0)] * (leaf.ndim - 1)
            return jnp.pad(leaf[:rows], longer)

        return jax.tree.map(fit, self)


class StoredElites(NamedTuple):
    """An archive of rows together with the store that it refers to."""

    archive: "GridArchive"  # its genotypes are int32 [C]
    store: Store

    def sample_solutions(self, key: jax.Array, count: int, fallback: jax.Array) -> jax.Array:
        """Draw elites' solutions, float [count, P]; copies of `fallback` when there is none.

        Consumes `key`.
        """
        rows = self.archive.sample_solutions(key, count, 0)
        return jnp.where(rows[:, None] > 0, self.store.solutions[rows], fallback[None])

    def dense(self) -> "GridArchive":
        """Give the archive with a solution in every cell, zeros in the empty ones."""
        solutions = self.store.solutions[self.archive.genotypes]
        return self.archive.replace(genotypes=solutions)


def is_store(node: Any) -> bool:
    """Tell a store from other nodes of a state."""
    return isinstance(node, Store)


def stores_in(state: Any) -> list[Store]:
    """List the stores in the state of a search."""
    return [node for node in jax.tree.leaves(state, is_leaf=is_store) if is_store(node)]
