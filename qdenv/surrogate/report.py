"""How a surrogate does: its losses, and its errors on evaluations that it has not seen."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdenv.surrogate.samples import Samples, spread_of
from qdenv.surrogate.surrogate import Aspect, Prediction, stages_of
from qdenv.types import Measure


class Report(NamedTuple):
    """What was measured last."""

    # float32 of each network, the mean of its last epoch; NaN before the first fit
    losses: dict[str, jax.Array]
    # float32 [heads], root mean squared error on the newest batch, predicted before it was learnt:
    # objective, result objective, measures
    rmse: jax.Array
    r2: jax.Array  # float32 [heads], the share of the batch's variance that is explained
    tiles: jax.Array  # float32, the share of tiles of repaired maps that were predicted

    def columns(self, measures: Sequence[Measure], fits: jax.Array) -> dict[str, jax.Array]:
        """Name the numbers; those of errors are NaN before the first fit."""
        heads = ["objective", "result", *(axis.name.replace(" ", "_") for axis in measures)]
        errors = {f"rmse_{name}": self.rmse[i] for i, name in enumerate(heads)}
        errors |= {f"r2_{name}": self.r2[i] for i, name in enumerate(heads)}
        losses = {f"loss_{name}": value for name, value in self.losses.items()}
        numbers = losses | errors | {"tiles_right": self.tiles}
        known = {name: jnp.where(fits > 0, value, jnp.nan) for name, value in numbers.items()}
        return {"fits": fits} | known


def blank_report(aspect: Aspect) -> Report:
    """Make the report of a surrogate that knows nothing."""
    heads = jnp.zeros(2 + aspect.measures)
    losses = {name: jnp.float32(0) for name in stages_of(aspect)}
    return Report(losses, heads, heads, jnp.float32(0))


def report_errors(
    report: Report, prediction: Prediction, samples: Samples, valid: jax.Array
) -> Report:
    """Measure the errors on a batch; one without valid samples changes nothing.

    Args:
        report: what was measured before.
        prediction: of the batch.
        samples: the truth.
        valid: bool [B], those that count.
    """
    score = prediction.score
    heads = [score.objective[:, None], score.result_objective[:, None], score.measures]
    rmse, r2 = errors(jnp.concatenate(heads, axis=1), samples.numbers, valid)
    alike = (prediction.repaired == samples.repaired).mean(axis=(1, 2))
    tiles = jnp.mean(alike, where=valid)
    some = valid.any()
    return report._replace(
        rmse=jnp.where(some, rmse, report.rmse),
        r2=jnp.where(some, r2, report.r2),
        tiles=jnp.where(some, tiles, report.tiles),
    )


def errors(predicted: jax.Array, truth: jax.Array, valid: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Compute RMSE and R^2 of numbers [B, heads] over the valid rows, each float32 [heads].

    R^2 is 1 - (mean squared error) / (variance of the truth); 0 where the truth does not vary.
    """
    counts = valid[:, None]
    squared = jnp.mean(jnp.square(predicted - truth), axis=0, where=counts)
    variance = spread_of(truth, valid)[1]
    share = jnp.where(variance > 0, 1 - squared / jnp.where(variance > 0, variance, 1), 0.0)
    return jnp.sqrt(squared), share
