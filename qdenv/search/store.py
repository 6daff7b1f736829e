"""One store of solutions for several archives, which refer to its rows, and how it grows.

A solution that two archives hold is stored once, and a search that has found little stores little.
Reading a checkpoint needs this file, but not qdax, which takes a second to import.
"""

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import jax
import jax.numpy as jnp

from qdenv.types import Array, Score

if TYPE_CHECKING:
    from qdenv.search.archive import GridArchive
    from qdenv.search.base import Algorithm

ROW = jax.ShapeDtypeStruct((), jnp.int32)  # what an archive holds in place of a solution
FIRST_ROWS = 1024  # of a store that grows; it doubles when need be, so a search compiles few times


class Store(NamedTuple):
    """Solutions by row, and which rows are free.

    Row 0 is what empty cells refer to: zeros, never handed out.
    """

    cells: jax.Array  # int32 [R], the cell that each row was last written for
    used: jax.Array  # bool [R], whether an archive refers to the row
    solutions: jax.Array  # float [R, P]

    @classmethod
    def empty(cls, solution: jax.Array, batch: int, *archives: "GridArchive") -> Self:
        """Make a store that always has free rows for a batch.

        Args:
            solution: one example, float [P].
            batch: solutions of every iteration.
            archives: those that will refer to it; each has at most one row for each of its cells.
        """
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

        Args:
            rows: int32 [B], from `free_rows`.
            solutions: float [B, P].
            cells: int32 [B].
            archives: all that refer to this store, after the batch.
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


def _is_store(node: Any) -> bool:
    return isinstance(node, Store)


def stores_in(state: Any) -> list[Store]:
    """List the stores in the state of a search."""
    return [node for node in jax.tree.leaves(state, is_leaf=_is_store) if _is_store(node)]


def growing(algorithm: "Algorithm") -> "Algorithm":
    """Compile an algorithm for a loop on the host; its stores grow between iterations.

    Every `Store` in the state starts small and doubles before a batch might not fit, up to the
    size at which it always does. The results are those of `algorithm` bit for bit.

    Args:
        algorithm: pure functions whose shapes never change.

    Returns:
        the same search as jitted functions (`archive` is left as it is). `tell` consumes the state
        that it is given, `ask` leaves it whole and copies nothing of it.
    """
    full = [
        len(store.used) for store in stores_in(jax.eval_shape(algorithm.init, jax.random.key(0)))
    ]
    changed: list[int] = []  # leaves of the state that `ask` changes, known once it is traced

    @jax.jit
    def ask_for_changes(state: Any) -> tuple[jax.Array, list[jax.Array]]:
        solutions, after = algorithm.ask(state)
        pairs = list(zip(jax.tree.leaves(state), jax.tree.leaves(after), strict=True))
        changed[:] = [number for number, (old, new) in enumerate(pairs) if new is not old]
        return solutions, [pairs[number][1] for number in changed]

    def ask(state: Any) -> tuple[jax.Array, Any]:
        solutions, new = ask_for_changes(state)
        leaves, structure = jax.tree.flatten(state)
        for number, leaf in zip(changed, new, strict=True):
            leaves[number] = leaf
        return solutions, jax.tree.unflatten(structure, leaves)

    tell = jax.jit(algorithm.tell, donate_argnums=0)

    @jax.jit
    def init(key: jax.Array) -> Any:
        # XLA makes no more of the zeros of an empty store than the rows that are left of them.
        sizes = [min(rows, max(FIRST_ROWS, 1 + algorithm.batch_size)) for rows in full]
        return _resized(algorithm.init(key), sizes)

    def resize_and_tell(
        state: Any, solutions: Array, score: Score, extras: Mapping[str, Array]
    ) -> Any:
        sizes = []
        for store, most in zip(stores_in(state), full, strict=True):
            rows, needed = len(store.used), int(store.used.sum()) + len(solutions)
            while rows < min(needed, most):
                rows = min(2 * rows, most)
            sizes.append(rows)
        return tell(_resized(state, sizes), solutions, score, extras)

    return algorithm._replace(init=init, ask=ask, tell=resize_and_tell)


def is_whole(state: Any) -> bool:
    """Return True if a state can be read: `tell` has not consumed any part of it."""
    arrays = [leaf for leaf in jax.tree.leaves(state) if isinstance(leaf, jax.Array)]
    return not any(array.is_deleted() for array in arrays)


def _resized(state: Any, sizes: list[int]) -> Any:
    """Resize the stores in a state; those that have their size already are not copied."""
    left = iter(sizes)

    def fit(node: Any) -> Any:
        if not _is_store(node):
            return node
        rows = next(left)
        return node if rows == len(node.used) else node.resized(rows)

    return jax.tree.map(fit, state, is_leaf=_is_store)
