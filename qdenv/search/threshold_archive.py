"""The soft archive of CMA-MAE: a cell's threshold follows the objectives it accepted.

Fontaine and Nikolaidis 2023, "Covariance matrix adaptation MAP-annealing",
https://arxiv.org/abs/2205.10752.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Self

import flax.struct
import jax
import jax.numpy as jnp

from qdenv.search.archive import GridArchive
from qdenv.search.settings import check_rates
from qdenv.types import Measure


class ThresholdArchive(GridArchive):
    """A grid archive whose cells accept whatever exceeds their threshold.

    A winner replaces the elite of its cell even when its objective is lower (the archive is not
    elitist): keep a `GridArchive` beside it for results.
    """

    thresholds: jax.Array  # float [C]
    # how far a threshold moves towards what it accepted, in [0, 1] (static)
    learning_rate: float = flax.struct.field(pytree_node=False)
    # threshold of an empty cell; -inf gives the archive of CMA-ME (static)
    threshold_min: float = flax.struct.field(pytree_node=False)

    @classmethod
    def empty(
        cls,
        solution: Any,
        measures: Sequence[Measure],
        extras: Mapping[str, Any] | None = None,
        learning_rate: float = 1.0,
        threshold_min: float = -math.inf,
    ) -> Self:
        """Make an archive without elites.

        Args:
            solution: one example solution.
            measures: the axes.
            extras: one example of what is stored beside each elite.
            learning_rate: in [0, 1]; must be 1 where `threshold_min` is -inf.
            threshold_min: threshold of an empty cell.

        Raises:
            InputError: the measures are no grid, or the two numbers do not go together.
        """
        check_rates(learning_rate, threshold_min)
        blank = GridArchive.empty(solution, measures, extras)
        thresholds = jnp.full_like(blank.objectives, threshold_min)
        parts = {name: getattr(blank, name) for name in GridArchive.__dataclass_fields__}
        return cls(
            **parts,
            thresholds=thresholds,
            learning_rate=float(learning_rate),
            threshold_min=float(threshold_min),
        )

    def threshold_of(self, cells: jax.Array) -> jax.Array:
        """Look up what a solution must exceed to enter each of `cells` (int32 [B] -> [B])."""
        return self.thresholds[cells]

    def _raise_thresholds(
        self,
        target: jax.Array,
        threshold: jax.Array,
        objective: jax.Array,
        accepted: jax.Array,
    ) -> Self:
        """Apply the batch rule: t' = (1 - a)^k t + mean(f_accepted) (1 - (1 - a)^k).

        k solutions of a batch beat the threshold t of one cell. One solution gives the paper's
        t' = (1 - a) t + a f; applied k times with the mean of the accepted objectives it sums up
        to this form, which no order of the batch can change (pyribs'). With threshold_min = -inf
        (CMA-ME) the threshold is the best accepted objective.
        """
        if self.threshold_min == -math.inf:
            raised = objective
        else:
            # Only the rows of winners are kept below; a row that shares a cell with no accepted
            # one divides by one instead of by zero.
            count = jnp.maximum(accepted.sum(axis=1), 1).astype(objective.dtype)
            # In parts so small that no sum of them overflows; a power of two rounds nothing.
            whole = 2.0 ** math.ceil(math.log2(max(objective.size, 1)))
            total = jnp.where(accepted, objective[None, :] / whole, 0).sum(axis=1)
            # Rounding alone can lead beyond the largest number, from next to it.
            largest = float(jnp.finfo(objective.dtype).max)
            mean = jnp.clip(total / count, -largest / whole, largest / whole) * whole
            ratio = jnp.asarray(1 - self.learning_rate, objective.dtype) ** count
            raised = jnp.clip(ratio * threshold + mean * (1 - ratio), -largest, largest)
        return self.replace(thresholds=self.thresholds.at[target].set(raised, mode="drop"))
