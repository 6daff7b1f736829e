"""The grid archive of MAP-Elites: a qdax repertoire with direct indexing.

Mouret and Clune 2015, "Illuminating search spaces by mapping elites",
https://arxiv.org/abs/1504.04909.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Self

import chex
import flax.struct
import jax
import jax.numpy as jnp
from qdax.core.containers.mapelites_repertoire import MapElitesRepertoire

from qdenv.search.axes import cell_index, check_measures, grid_centroids
from qdenv.search.insertion import Insertion, first_of_best, put
from qdenv.types import Array, InputError, Measure


class GridArchive(MapElitesRepertoire):
    """The best solution of every cell of a regular grid over the measures.

    A qdax `MapElitesRepertoire` (selectors, metrics and the `MAPElites` driver accept it) whose
    cells are found by direct indexing. Cells are numbered row-major, the last measure fastest.

    Attributes:
        genotypes: solutions, pytree of [C, ...].
        fitnesses: float [C, 1], the objectives; -inf where a cell is empty.
        descriptors: float [C, M], the measures of the elites.
        centroids: float [C, M], the centres of the cells.
        extra_scores: dict of arrays [C, ...] kept beside each elite.
    """

    measures: tuple[Measure, ...] = flax.struct.field(pytree_node=False)  # the axes (static)

    @classmethod
    def empty(
        cls, solution: Any, measures: Sequence[Measure], extras: Mapping[str, Any] | None = None
    ) -> Self:
        """Make an archive without elites.

        Args:
            solution: one example solution (shapes and dtypes are read, not values).
            measures: the axes.
            extras: one example of what is stored beside each elite.

        Raises:
            InputError: the measures are no grid.
        """
        axes = check_measures(measures)
        extras = dict(extras or {})
        cells = math.prod(axis.cells for axis in axes)

        def blank(leaf: Any) -> jax.Array:
            return jnp.zeros((cells, *jnp.shape(leaf)), jax.dtypes.canonicalize_dtype(leaf.dtype))

        centroids = grid_centroids(axes)
        return cls(
            genotypes=jax.tree.map(blank, solution),
            fitnesses=jnp.full((cells, 1), -jnp.inf, centroids.dtype),
            descriptors=jnp.zeros_like(centroids),
            centroids=centroids,
            extra_scores=jax.tree.map(blank, extras),
            keys_extra_scores=tuple(sorted(extras)),
            measures=axes,
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
        extra_scores: Mapping[str, Array] | None = None,
        keys_extra_scores: tuple[str, ...] = (),
    ) -> Self:
        """Make an archive of a first batch, as qdax's `MAPElites` asks for it.

        Bind the grid first: ``functools.partial(GridArchive.init, measures=measures)``. The
        `centroids` follow from the measures and are ignored.
        """
        extras = {
            key: value for key, value in (extra_scores or {}).items() if key in keys_extra_scores
        }
        first_solution, first_extras = jax.tree.map(lambda leaf: leaf[0], (genotypes, extras))
        archive = cls.empty(first_solution, measures, first_extras)
        return archive.add(genotypes, descriptors, fitnesses, extras)

    def cells_of(self, measures: Array) -> jax.Array:
        """Find the cells of measures [..., M] -> int32 [...]; outside values go to the rim."""
        return cell_index(measures, self.measures)

    def insert(
        self,
        solutions: Any,
        objective: Array,
        measures: Array,
        extras: Mapping[str, Array] | None = None,
        success: Array | bool = True,
    ) -> tuple[Self, Insertion]:
        """Add a batch at once: every solution is judged against the archive before the batch.

        The winner of a cell is the best accepted solution, the first one on a tie (pyribs'
        ``GridArchive.add``). Rows that failed, or whose objective or measures are not finite,
        enter nothing.

        Args:
            solutions: pytree of [B, ...].
            objective: float [B].
            measures: float [B, M].
            extras: dict of arrays [B, ...]; must hold the keys declared at construction.
            success: bool [B].

        Returns:
            The new archive and the `Insertion` of each row.

        Raises:
            InputError: a declared extra is missing (when tracing, not inside jit).
            AssertionError: a shape is wrong (when tracing).
        """
        objective = jnp.asarray(objective, self.fitnesses.dtype)
        measures = jnp.asarray(measures, self.descriptors.dtype)
        chex.assert_rank(objective, 1)
        chex.assert_shape(measures, (*objective.shape, len(self.measures)))
        chex.assert_tree_shape_prefix(solutions, objective.shape)
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
        # decides nothing but ties; only the winners are written.
        same_cell = cells[:, None] == cells[None, :]
        winner = first_of_best(objective, accepted, same_cell)
        target = jnp.where(winner, cells, self.fitnesses.shape[0])  # others: out of bounds
        kept = self._wanted(extras or {})
        archive = self._raise_thresholds(
            target, threshold, objective, same_cell & accepted[None, :]
        )
        archive = archive.replace(
            genotypes=put(self.genotypes, target, solutions),
            fitnesses=put(self.fitnesses, target, objective[:, None]),
            descriptors=put(self.descriptors, target, measures),
            extra_scores=put(self.extra_scores, target, kept),
        )
        return archive, Insertion(status, value)

    def _wanted(self, extras: Mapping[str, Array]) -> dict[str, Array]:
        for key in self.keys_extra_scores:
            if key not in extras:
                raise InputError(f"this archive stores {key!r} beside each elite: hand it in")
        return {key: extras[key] for key in self.keys_extra_scores}

    def threshold_of(self, cells: jax.Array) -> jax.Array:
        """Look up what a solution must exceed to enter each of `cells` (int32 [B] -> [B])."""
        return self.fitnesses[cells, 0]

    def _raise_thresholds(
        self,
        target: jax.Array,
        threshold: jax.Array,
        objective: jax.Array,
        accepted: jax.Array,
    ) -> Self:
        return self  # the threshold of an elitist archive is the objective itself

    def add(
        self,
        batch_of_genotypes: Any,
        batch_of_descriptors: Array,
        batch_of_fitnesses: Array,
        batch_of_extra_scores: Mapping[str, Array] | None = None,
    ) -> Self:
        """Add a batch (qdax's signature; see `insert`)."""
        objective = jnp.reshape(batch_of_fitnesses, (batch_of_descriptors.shape[0],))
        extras = batch_of_extra_scores
        return self.insert(batch_of_genotypes, objective, batch_of_descriptors, extras)[0]

    @property
    def objectives(self) -> jax.Array:
        """Give the objective of every cell, float [C]; -inf where empty."""
        return self.fitnesses[:, 0]

    @property
    def filled(self) -> jax.Array:
        """Mark the cells that hold an elite, bool [C]."""
        return self.objectives > -jnp.inf

    def qd_score(self, offset: float = 0.0) -> jax.Array:
        """Sum the objectives minus `offset` over the filled cells; 0 when empty.

        The QD-score of Pugh, Soros and Stanley 2016, "Quality diversity: a new frontier for
        evolutionary computation", https://doi.org/10.3389/frobt.2016.00040.
        """
        return jnp.sum(self.objectives - offset, where=self.filled)

    @property
    def coverage(self) -> jax.Array:
        """Give the share of filled cells, in [0, 1]."""
        return self.filled.mean()

    @property
    def best(self) -> jax.Array:
        """Give the cell of the best elite, int32; the first on a tie, 0 when empty."""
        return jnp.argmax(self.objectives).astype(jnp.int32)

    def sample_cells(self, key: jax.Array, count: int) -> jax.Array:
        """Draw filled cells uniformly with replacement, int32 [count]; 0 when there is none.

        Consumes `key`.
        """
        # The r-th filled cell is where the running count first exceeds r: uniform without a list
        # of filled cells, whose length would not be static.
        ranks = jnp.cumsum(self.filled)
        draws = jax.random.randint(key, (count,), 0, jnp.maximum(ranks[-1], 1))
        cells = jnp.searchsorted(ranks, draws, side="right")
        return jnp.where(ranks[-1] > 0, cells, 0).astype(jnp.int32)

    def sample_solutions(self, key: jax.Array, count: int, fallback: Any) -> Any:
        """Draw elites' solutions, pytree of [count, ...]; copies of `fallback` when empty.

        Consumes `key`.
        """
        cells = self.sample_cells(key, count)
        some = self.filled.any()
        return jax.tree.map(
            lambda stored, other: jnp.where(some, stored[cells], other), self.genotypes, fallback
        )
