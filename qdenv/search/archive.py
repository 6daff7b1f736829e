"""The grid archive of MAP-Elites and CMA-MAE: a qdax repertoire with direct indexing.

Mouret and Clune 2015, "Illuminating search spaces by mapping elites",
https://arxiv.org/abs/1504.04909; Fontaine and Nikolaidis 2023, "Covariance matrix adaptation
MAP-annealing", https://arxiv.org/abs/2205.10752.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Self

import chex
import flax.struct
import jax
import jax.numpy as jnp
import numpy as np
from qdax.core.containers.mapelites_repertoire import MapElitesRepertoire

from qdenv.search.axes import check_measures, inner_edges
from qdenv.search.settings import check_rates
from qdenv.types import Array, Extras, InputError, Measure


class Insertion(NamedTuple):
    """How an archive received each solution of a batch, compared with the archive before it."""

    status: jax.Array  # int32 [B], 2 fills a new cell, 1 improves a filled one, 0 is not accepted
    value: jax.Array  # float [B], objective minus the threshold (-inf counts 0); -inf for a failure


class GridArchive(MapElitesRepertoire):
    """The best solution of every cell of a regular grid over the measures.

    A qdax `MapElitesRepertoire` (selectors, metrics and the `MAPElites` driver accept it) whose
    cells are found by direct indexing. Cells are numbered row-major, the last measure fastest.

    With `thresholds` it is the soft archive of CMA-MAE: a cell accepts whatever exceeds its
    threshold, which follows the objectives that it accepted. A winner then replaces the elite of
    its cell even when its objective is lower: keep an archive without thresholds for results.

    Attributes:
        genotypes: solutions, pytree of [C, ...].
        fitnesses: float [C, 1], the objectives; -inf where a cell is empty.
        descriptors: float [C, M], the measures of the elites.
        centroids: float [C, M], the centres of the cells.
        extra_scores: dict of arrays [C, ...] stored beside each elite.
    """

    measures: tuple[Measure, ...] = flax.struct.field(pytree_node=False)  # the axes (static)
    thresholds: jax.Array | None = None  # float [C]; None where the archive is elitist
    # how far a threshold moves towards what it accepted, in [0, 1] (static)
    learning_rate: float = flax.struct.field(pytree_node=False, default=1.0)
    # threshold of an empty cell; -inf gives the archive of CMA-ME (static)
    threshold_min: float = flax.struct.field(pytree_node=False, default=-math.inf)

    @classmethod
    def empty(
        cls,
        solution: Any,
        measures: Sequence[Measure],
        extras: Mapping[str, Any] | None = None,
        learning_rate: float | None = None,
        threshold_min: float = -math.inf,
    ) -> Self:
        """Make an archive without elites.

        Args:
            solution: an example of what each cell stores, an array or a pytree; its shapes and
                dtypes are read.
            measures: the axes.
            extras: examples of what is stored beside each elite, by name.
            learning_rate: of thresholds, in [0, 1], and 1 where `threshold_min` is -inf; None makes
                an elitist archive.
            threshold_min: threshold of an empty cell.

        Raises:
            InputError: the measures make no grid, or the two numbers do not go together.
        """
        axes = check_measures(measures)
        extras = dict(extras or {})
        centres = [
            axis.low + (np.arange(axis.cells) + 0.5) * (axis.high - axis.low) / axis.cells
            for axis in axes
        ]
        grid = np.stack(np.meshgrid(*centres, indexing="ij"), axis=-1).reshape(-1, len(axes))
        centroids = jnp.asarray(grid, jnp.result_type(float))
        cells = len(grid)
        thresholds = None
        if learning_rate is not None:
            check_rates(learning_rate, threshold_min)
            thresholds = jnp.full(cells, threshold_min, centroids.dtype)

        def blank(leaf: Any) -> jax.Array:
            return jnp.zeros((cells, *jnp.shape(leaf)), jax.dtypes.canonicalize_dtype(leaf.dtype))

        return cls(
            genotypes=jax.tree.map(blank, solution),
            fitnesses=jnp.full((cells, 1), -jnp.inf, centroids.dtype),
            descriptors=jnp.zeros_like(centroids),
            centroids=centroids,
            extra_scores=jax.tree.map(blank, extras),
            keys_extra_scores=tuple(sorted(extras)),
            measures=axes,
            thresholds=thresholds,
            learning_rate=1.0 if learning_rate is None else float(learning_rate),
            threshold_min=float(threshold_min),
        )

    @classmethod
    def init(
        cls,
        genotypes: Any,
        fitnesses: Array,
        descriptors: Array,
        centroids: Array | None = None,
        *args: Any,
        measures: Sequence[Measure],
        extra_scores: Extras | None = None,
        keys_extra_scores: tuple[str, ...] = (),
    ) -> Self:
        """Make an archive of a first batch, which may be empty, as qdax's `MAPElites` expects it.

        Bind the axes first: ``functools.partial(GridArchive.init, measures=measures)``. Solutions
        are `genotypes` (pytree of [B, ...]), objectives `fitnesses` (float [B] or [B, 1]), measures
        `descriptors` (float [B, M]). Of the `extra_scores`, arrays [B, ...] by name, those that
        `keys_extra_scores` names are stored. `centroids`, which follow from the axes, and `args`
        are ignored. Raises InputError if the measures make no grid.
        """
        extras = {
            key: value for key, value in (extra_scores or {}).items() if key in keys_extra_scores
        }
        one_solution, one_extras = jax.tree.map(
            lambda leaf: jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype), (genotypes, extras)
        )
        archive = cls.empty(one_solution, measures, one_extras)
        return archive.add(genotypes, descriptors, fitnesses, extras)

    def cells_of(self, measures: Array) -> jax.Array:
        """Find the cells of measures [..., M] -> int32 [...], row-major.

        Values outside an axis go to its first or last cell, NaN to the first.
        """
        if not jnp.issubdtype(measures.dtype, jnp.floating):  # edges are no whole numbers
            measures = measures.astype(self.descriptors.dtype)
        index = jnp.zeros(measures.shape[:-1], jnp.int32)
        for position, axis in enumerate(self.measures):
            values = measures[..., position]
            edges = inner_edges(axis, np.dtype(values.dtype)).reshape(*[1] * values.ndim, -1)
            # Counting the edges at or below a value clips it to the grid and puts NaN first.
            along = (values[..., None] >= edges).sum(axis=-1, dtype=jnp.int32)
            index = index * axis.cells + along
        return index

    def threshold_of(self, cells: jax.Array) -> jax.Array:
        """Return what an objective must exceed to enter `cells` (int32 [B] -> float [B])."""
        return self.fitnesses[cells, 0] if self.thresholds is None else self.thresholds[cells]

    def insert(
        self,
        solutions: Any,
        objective: Array,
        measures: Array,
        extras: Extras | None = None,
        success: Array | bool = True,
    ) -> tuple[Self, Insertion]:
        """Add a batch at once: every solution is judged against the archive before the batch.

        The winner of a cell is the best accepted solution, the first one on a tie (pyribs'
        ``GridArchive.add``). Thresholds t follow what they accept, t' = (1 - a) t + a f, with the
        learning rate a.

        Args:
            solutions: pytree of [B, ...].
            objective: float [B]; a row that is not finite enters nothing.
            measures: float [B, M]; a row that is not finite enters nothing.
            extras: arrays [B, ...] by name, at least those declared at construction.
            success: bool [B], False for rows that enter nothing.

        Returns the archive, and how each row was received. Raises InputError, when tracing, if one
        of the extras is missing.
        """
        objective = jnp.asarray(objective, self.fitnesses.dtype)
        measures = jnp.asarray(measures, self.descriptors.dtype)
        chex.assert_rank(objective, 1)
        chex.assert_shape(measures, (*objective.shape, len(self.measures)))
        extras = extras or {}
        if missing := [key for key in self.keys_extra_scores if key not in extras]:
            raise InputError(f"this archive stores {missing[0]!r} beside each elite: pass it")
        stored = {key: extras[key] for key in self.keys_extra_scores}
        chex.assert_tree_shape_prefix((solutions, stored), objective.shape)
        # A failed row gets the objective that beats no threshold: it needs no case of its own.
        valid = success & jnp.isfinite(objective) & jnp.isfinite(measures).all(axis=-1)
        objective = jnp.where(valid, objective, -jnp.inf)
        cells = self.cells_of(measures)
        threshold = self.threshold_of(cells)
        accepted = objective > threshold
        filled = self.fitnesses[cells, 0] > -jnp.inf
        status = jnp.where(accepted, jnp.where(filled, 1, 2), 0).astype(jnp.int32)
        value = objective - jnp.where(jnp.isneginf(threshold), 0, threshold)

        # Every row was judged against the archive before the batch, so the order of the rows
        # decides nothing but ties, which go to the first; only the winners are written. They are
        # found by pairs of rows: scatters to equal targets land in no defined order.
        rows = jnp.arange(len(objective))
        rivals = (cells[:, None] == cells[None, :]) & accepted[None, :]
        above = objective[None, :] > objective[:, None]
        tied_before = (objective[None, :] == objective[:, None]) & (rows[None, :] < rows[:, None])
        winner = accepted & ~(rivals & (above | tied_before)).any(axis=1)
        target = jnp.where(winner, cells, self.fitnesses.shape[0])  # others: out of bounds
        archive = self
        if self.thresholds is not None:
            raised = _annealed(threshold, objective, rivals, self.learning_rate, self.threshold_min)
            archive = self.replace(thresholds=_put(self.thresholds, target, raised))
        archive = archive.replace(
            genotypes=_put(self.genotypes, target, solutions),
            fitnesses=_put(self.fitnesses, target, objective[:, None]),
            descriptors=_put(self.descriptors, target, measures),
            extra_scores=_put(self.extra_scores, target, stored),
        )
        return archive, Insertion(status, value)

    def add(
        self,
        batch_of_genotypes: Any,
        batch_of_descriptors: Array,
        batch_of_fitnesses: Array,
        batch_of_extra_scores: Extras | None = None,
    ) -> Self:
        """Add a batch as `insert` does, with the names of qdax.

        Solutions are `batch_of_genotypes` [B, ...], measures `batch_of_descriptors` [B, M],
        objectives `batch_of_fitnesses` [B] or [B, 1], and extras `batch_of_extra_scores`.
        """
        objective = jnp.reshape(batch_of_fitnesses, (batch_of_descriptors.shape[0],))
        extras = batch_of_extra_scores
        return self.insert(batch_of_genotypes, objective, batch_of_descriptors, extras)[0]

    def __repr__(self) -> str:
        """Show the grid, and the number of elites where it is known (not inside of `jax.jit`)."""
        grid = " x ".join(str(axis.cells) for axis in self.measures)
        known = not isinstance(self.fitnesses, jax.core.Tracer)
        elites = f", {int(self.filled.sum())} elites, QD-score {self.qd_score:.4g}" if known else ""
        return f"GridArchive({grid} cells{elites})"

    @property
    def objectives(self) -> jax.Array:
        """Return the objective of every cell, float [C]; -inf where empty."""
        return self.fitnesses[:, 0]

    @property
    def filled(self) -> jax.Array:
        """Mark the cells that hold an elite, bool [C]."""
        return self.objectives > -jnp.inf

    @property
    def qd_score(self) -> jax.Array:
        """Return the sum of the objectives over the filled cells, float []; 0 when empty.

        Pugh, Soros and Stanley 2016, https://doi.org/10.3389/frobt.2016.00040.
        """
        return jnp.sum(self.objectives, where=self.filled)

    @property
    def coverage(self) -> jax.Array:
        """Return the share of filled cells, float [], in [0, 1]."""
        return self.filled.mean()

    def sample_solutions(self, key: jax.Array, count: int, fallback: Any) -> Any:
        """Draw elites uniformly with replacement: their solutions, pytree of [count, ...].

        Copies of `fallback`, one solution, where the archive is empty. Consumes `key`.
        """
        # The r-th filled cell is where the running count first exceeds r: uniform without a list
        # of filled cells, whose length would not be static.
        ranks = jnp.cumsum(self.filled)
        draws = jax.random.randint(key, (count,), 0, jnp.maximum(ranks[-1], 1))
        cells = jnp.searchsorted(ranks, draws, side="right")
        some = ranks[-1] > 0  # else the cells are out of bounds, and what is there is not taken
        return jax.tree.map(
            lambda stored, other: jnp.where(some, stored[cells], other), self.genotypes, fallback
        )

    def columns(self) -> dict[str, jax.Array]:
        """Return arrays over all cells by the names that files hold.

        They are ``solution`` float [C, P], ``objective`` float [C], ``measures`` float [C, M], for
        a soft archive ``threshold`` float [C], and every extra [C, ...]. Raises InputError if the
        solutions are no single array [C, P], or an extra takes a column's name.
        """
        if not hasattr(self.genotypes, "shape"):
            raise InputError("only an archive whose solutions are one array [C, P] can be exported")
        columns = {
            "solution": self.genotypes,
            "objective": self.objectives,
            "measures": self.descriptors,
        }
        if self.thresholds is not None:
            columns["threshold"] = self.thresholds
        if taken := {*columns, "index", "threshold"} & self.extra_scores.keys():
            raise InputError(f"rename the extra {sorted(taken)[0]!r}: an archive has that field")
        return {**columns, **self.extra_scores}

    def elites(self) -> dict[str, np.ndarray]:
        """Return the filled cells as numpy arrays, with an axis of n elites in place of C.

        They are ``index`` (int64 [n], the cells) and the `columns`: what a run's archive.npz holds.
        Raises InputError as these do.
        """
        index = np.flatnonzero(self.filled)
        columns = {name: np.asarray(column)[index] for name, column in self.columns().items()}
        return {"index": index} | columns


def _annealed(
    threshold: jax.Array,
    objective: jax.Array,
    rivals: jax.Array,
    learning_rate: float,
    threshold_min: float,
) -> jax.Array:
    """Raise thresholds by the batch rule, t' = (1 - a)^k t + mean(f_accepted) (1 - (1 - a)^k).

    k solutions of a batch beat the threshold t of one cell. One solution gives the paper's
    t' = (1 - a) t + a f; applied k times with the mean of the accepted objectives it sums up to
    this form, which no order of the batch can change (pyribs'). With threshold_min = -inf
    (CMA-ME) the threshold is the best accepted objective.

    `threshold`, of each row's cell, and `objective` are float [B]; `rivals` (bool [B, B]) are the
    accepted rows in each row's cell. The result, float [B], is right in the rows of winners.
    """
    if threshold_min == -math.inf:
        return objective
    # A row that shares a cell with no accepted one divides by one instead of by zero.
    count = jnp.maximum(rivals.sum(axis=1), 1).astype(objective.dtype)
    # In parts so small that no sum of them overflows; a power of two rounds nothing.
    whole = 2.0 ** math.ceil(math.log2(max(objective.size, 1)))
    total = jnp.where(rivals, objective[None, :] / whole, 0).sum(axis=1)
    # Rounding alone can lead beyond the largest number, from next to it.
    largest = float(jnp.finfo(objective.dtype).max)
    mean = jnp.clip(total / count, -largest / whole, largest / whole) * whole
    ratio = jnp.asarray(1 - learning_rate, objective.dtype) ** count
    return jnp.clip(ratio * threshold + mean * (1 - ratio), -largest, largest)


def _put(stored: Any, target: Array, rows: Any) -> Any:
    """Write rows [B, ...] to the cells `target` (int32 [B]); cells out of bounds are dropped."""
    return jax.tree.map(
        lambda old, new: old.at[target].set(jnp.asarray(new, old.dtype), mode="drop"), stored, rows
    )
