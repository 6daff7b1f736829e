"""The interface of all search algorithms: `init / ask / tell` on a single pytree of state.

Solutions that several archives hold are stored once, in a `Store`; the archives refer to its rows.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Self

import chex
import jax
import jax.numpy as jnp
import numpy as np

from qdenv.search.archive import GridArchive, Insertion
from qdenv.types import Array, Encoding, Extras, InputError, Measure, Score

ROW = jax.ShapeDtypeStruct((), jnp.int32)  # what an archive holds in place of a solution
_FIRST_ROWS = 1024  # of a store that grows; it doubles when need be, so a search compiles few times
_COLLECTED_AT_ONCE = 1024  # elites: enough that calls cost little, few beside the archive's cells


class Problem(NamedTuple):
    """What an algorithm searches."""

    solution_dim: int  # P, the parameters of a solution
    measures: Sequence[Measure]  # axes of the archives
    # one example of what the result archive stores beside each elite
    extras: Mapping[str, Any] | None = None
    encoding: Encoding | None = None  # None where solutions are nothing but numbers


class Store(NamedTuple):
    """The solutions of several archives by row, each once, and which rows are free.

    Row 0 is what empty cells refer to: zeros, never handed out. A search with few elites stores
    little.
    """

    cells: jax.Array  # int32 [R], the cell that each row was last written for
    used: jax.Array  # bool [R], whether an archive refers to the row
    solutions: jax.Array  # float [R, P]

    @classmethod
    def empty(cls, solution: jax.Array, batch: int, *archives: GridArchive) -> Self:
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
        self, rows: jax.Array, solutions: jax.Array, cells: jax.Array, *archives: GridArchive
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
        more = (0, max(rows - len(self.used), 0))
        return jax.tree.map(
            lambda leaf: jnp.pad(leaf[:rows], [more] + [(0, 0)] * (leaf.ndim - 1)), self
        )


def stores_in(state: Any) -> list[Store]:
    """List the stores in the state of a search."""
    nodes = jax.tree.leaves(state, is_leaf=lambda node: isinstance(node, Store))
    return [node for node in nodes if isinstance(node, Store)]


class StoredArchive(NamedTuple):
    """The archives of a search, which refer to rows of one store of solutions."""

    # steers the search, judged by `Score.objective`; None where the search needs no archive
    learning: GridArchive | None
    # the best by `Score.result_objective`. A soft learning archive may replace a better elite by a
    # worse one: results need an archive of their own.
    result: GridArchive
    store: Store

    @classmethod
    def empty(
        cls,
        problem: Problem,
        solution: jax.Array,
        batch: int,
        thresholds: tuple[float, float] | None = None,
    ) -> Self:
        """Make archives without elites for solutions like `solution` (float [P]).

        `thresholds` are learning rate and minimum of the learning archive; None makes none.
        """
        result, learning = GridArchive.empty(ROW, problem.measures, problem.extras), None
        if thresholds:
            learning = GridArchive.empty(ROW, problem.measures, None, *thresholds)
        archives = [result] if learning is None else [learning, result]
        return cls(learning, result, Store.empty(solution, batch, *archives))

    def add(self, solutions: jax.Array, score: Score, extras: Extras) -> tuple[Self, Insertion]:
        """Add a batch, as `check_batch` returns it, to all archives.

        Returns them, and how the learning archive (the result archive where there is none) received
        each row.
        """
        rows, learning = self.store.free_rows(len(solutions)), self.learning
        objective, result_objective, measures, success = score
        result, insertion = self.result.insert(rows, result_objective, measures, extras, success)
        archives, cells = [result], result.cells_of(measures)
        if learning is not None:
            learning, insertion = learning.insert(rows, objective, measures, None, success)
            archives = [learning, result]
        store = self.store.write(rows, solutions, cells, *archives)
        return type(self)(learning, result, store), insertion

    def sample_solutions(self, key: jax.Array, count: int, fallback: jax.Array) -> jax.Array:
        """Draw solutions of the learning archive, float [count, P]; copies of `fallback` if empty.

        Consumes `key`.
        """
        assert self.learning is not None, "this search has no learning archive"
        rows = self.learning.sample_solutions(key, count, 0)
        return jnp.where(rows[:, None] > 0, self.store.solutions[rows], fallback[None])

    def dense(self) -> GridArchive:
        """Return the result archive with a solution in every cell, zeros in the empty ones."""
        return self.result.replace(genotypes=self.store.solutions[self.result.genotypes])


class SearchState(NamedTuple):
    """State of a search by emitters, by a population or by its archives alone; one pytree."""

    key: jax.Array
    # that of `Emitters`, which the learning archive steers, or a `rearrange.Population`; None where
    # parents are drawn from that archive, or nothing is learnt
    emitters: Any
    archives: StoredArchive


class Algorithm(NamedTuple):
    """A search algorithm as a record of pure, jittable functions."""

    # key -> state. The state is one pytree of arrays with the random key inside; its shapes never
    # change.
    init: Callable[[jax.Array], Any]
    ask: Callable[[Any], tuple[jax.Array, Any]]  # state -> (solutions float [B, P], state)
    # (state, solutions, `Score` with a leading axis B, extras: dict of arrays [B, ...], those of
    # the problem and others) -> state. Rows whose score is no success enter no archive and do not
    # change the rank of other rows.
    tell: Callable[[Any, Array, Score, Extras], Any]
    archive: Callable[[Any], GridArchive]  # state -> the result archive
    batch_size: int  # B, the number of solutions of every ask
    # state -> numbers by name that a run logs after each iteration; NaN while they are undefined.
    # The names never change.
    notes: Callable[[Any], Mapping[str, jax.Array]] = lambda state: {}
    # populations that may be drawn before the scores of the one before them are known; `tell`
    # receives them in the order in which `ask` drew them
    ahead: int = 0


def check_batch(solutions: Array, score: Score) -> tuple[jax.Array, Score]:
    """Check the arguments of `tell`; rows that hold anything not finite count as failed."""
    solutions = jnp.asarray(solutions)
    score = Score(*(jnp.asarray(column) for column in score))
    chex.assert_rank([solutions, *score], [2, 1, 1, 2, 1])
    chex.assert_equal_shape_prefix([solutions, *score], 1)
    finite = jnp.isfinite(jnp.column_stack([solutions, *score[:3]])).all(axis=-1)
    return solutions, score._replace(success=score.success & finite)


def start_solution(x0: Array | None, solution_dim: int) -> jax.Array:
    """Return the solution the search starts from, float [P]: `x0`, or zeros where it is None."""
    if solution_dim < 1:
        raise InputError(f"a solution needs at least one parameter, not {solution_dim}")
    if x0 is None:
        return jnp.zeros(solution_dim)
    x0 = np.asarray(x0)
    if x0.shape != (solution_dim,) or not np.isfinite(x0).all():
        raise InputError(f"x0 must hold {solution_dim} finite numbers, its shape is {x0.shape}")
    return jnp.asarray(x0, jnp.result_type(float))


def plain_key(key: jax.Array) -> jax.Array:
    """Return the data of a random key, uint32 [2], so that a state is plain arrays throughout."""
    return jax.random.key_data(key) if jnp.issubdtype(key.dtype, jax.dtypes.prng_key) else key


def growing(algorithm: Algorithm) -> Algorithm:
    """Compile an algorithm for a loop on the host; its stores grow between iterations.

    Every `Store` in the state starts small and doubles before a batch might not fit, up to the
    size at which it always does. The results are those of `algorithm` bit for bit, the functions
    are jitted (`archive` is left as it is). `tell` consumes the state that it is given, `ask`
    leaves it whole and copies no archive and no store.
    """
    shapes = jax.eval_shape(algorithm.init, jax.random.key(0))
    full = [len(store.used) for store in stores_in(shapes)]
    changed: list[int] = []  # leaves of the state that `ask` changes, known once it is traced

    def resize(state: Any, sizes: list[int]) -> Any:
        """Resize the stores in a state; those that have their size already are not copied."""
        left = iter(sizes)

        def fit(node: Any) -> Any:
            if not isinstance(node, Store):
                return node
            rows = next(left)
            return node if rows == len(node.used) else node.resized(rows)

        return jax.tree.map(fit, state, is_leaf=lambda node: isinstance(node, Store))

    # XLA makes no more of the zeros of an empty store than the rows that are left of them.
    first = [min(rows, max(_FIRST_ROWS, 1 + algorithm.batch_size)) for rows in full]
    init = jax.jit(lambda key: resize(algorithm.init(key), first))

    @jax.jit
    def ask_for_changes(state: Any) -> tuple[jax.Array, list[jax.Array]]:
        # A jitted function copies whatever it returns: unchanged leaves are left out.
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

    jitted_tell = jax.jit(algorithm.tell, donate_argnums=0)

    def tell(state: Any, solutions: Array, score: Score, extras: Extras) -> Any:
        sizes = []
        for store, most in zip(stores_in(state), full, strict=True):
            rows, needed = len(store.used), int(store.used.sum()) + len(solutions)
            while rows < min(needed, most):
                rows = min(2 * rows, most)
            sizes.append(rows)
        return jitted_tell(resize(state, sizes), solutions, score, extras)

    return algorithm._replace(init=init, ask=ask, tell=tell)


def collector(algorithm: Algorithm) -> Callable[[Any], dict[str, np.ndarray]]:
    """Make the function state -> `GridArchive.elites` of the result archive, for large searches.

    On the way no archive is made that holds a solution for every cell.
    """
    filled = jax.jit(lambda state: algorithm.archive(state).filled)

    @jax.jit
    def take(state: Any, cells: jax.Array) -> dict[str, jax.Array]:
        # XLA fuses both look-ups, the cell's row and the row's solution, into one.
        return jax.tree.map(lambda leaf: leaf[cells], algorithm.archive(state)).columns()

    def collect(state: Any) -> dict[str, np.ndarray]:
        index = np.flatnonzero(filled(state))
        columns = {
            name: np.empty((len(index), *column.shape[1:]), column.dtype)
            for name, column in jax.eval_shape(take, state, index).items()
        }
        for start in range(0, len(index), _COLLECTED_AT_ONCE):
            part = index[start : start + _COLLECTED_AT_ONCE]
            # Filled up to one shape, so that one program is compiled for all parts.
            cells = np.zeros(_COLLECTED_AT_ONCE, np.int32)
            cells[: len(part)] = part
            for name, column in take(state, cells).items():
                columns[name][start : start + len(part)] = np.asarray(column)[: len(part)]
        return {"index": index} | columns

    return collect
