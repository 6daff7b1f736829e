"""The surrogate of a search: it learns from true evaluations and reports its errors."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from qdenv.search.base import Problem
from qdenv.surrogates.settings import SurrogateConfig
from qdenv.surrogates.surrogate import Fitted, Ring, Samples, Surrogate, errors
from qdenv.types import Extras, InputError, Score


class ModelState(NamedTuple):
    """A surrogate, what it learns from, and its losses and errors as measured last."""

    fitted: Fitted
    ring: Ring  # true evaluations
    # float32 of each network, the mean of its last epoch; 0 before the first fit
    losses: dict[str, jax.Array]
    # float32 [heads], root mean squared error on the newest batch, predicted before it was learnt:
    # objective, result objective, measures
    rmse: jax.Array
    r2: jax.Array  # float32 [heads], the share of the batch's variance that is explained
    tiles: jax.Array  # float32, the share of tiles of repaired maps that were predicted


class Model:
    """The surrogate of a search."""

    def __init__(self, config: SurrogateConfig, problem: Problem, name: str) -> None:
        """Make the surrogate; `name` is that of the search's algorithm, for messages.

        Raises InputError if solutions are nothing but numbers, or a setting is impossible.
        """
        if problem.encoding is None:
            raise InputError(f"{name} learns from layouts: this problem's solutions encode none")
        self.encoding, self._measures = problem.encoding, problem.measures
        self._samples = config.samples
        self.surrogate = Surrogate(config, self.encoding, len(self._measures))

    def init(self, key: jax.Array) -> ModelState:
        """Begin without samples; consumes `key`."""
        zeros = jnp.zeros(self.surrogate.heads)
        return ModelState(
            fitted=self.surrogate.init(key),
            ring=Ring.empty(self._samples, self.encoding.shape, self.surrogate.heads),
            losses={stage: jnp.float32(0) for stage in self.surrogate.stages},
            rmse=zeros,
            r2=zeros,
            tiles=jnp.float32(0),
        )

    def predict(self, fitted: Fitted, solutions: jax.Array) -> Score:
        """Predict the `Score` of solutions [B, P], with a leading axis B."""
        drawn = self.encoding.draw(solutions.astype(jnp.float32))
        return self.surrogate.predict(fitted, drawn)[0]

    def observe(
        self, state: ModelState, solutions: jax.Array, score: Score, extras: Extras
    ) -> ModelState:
        """Measure the errors on a batch, whose successes can be learnt from afterwards.

        `score` and `extras` are as `Algorithm.tell` has them.
        """
        encoding = self.encoding
        drawn = encoding.draw(solutions)
        samples = Samples(
            drawn,
            jnp.asarray(extras["repaired"]) if encoding.repairs else drawn,
            jnp.asarray(extras["usage"]) if encoding.usage else jnp.zeros(drawn.shape),
            jnp.column_stack(score[:3]),
        )
        # Predicted before it is learnt from: the errors are those on unseen layouts.
        predicted, repaired, _ = self.surrogate.predict(state.fitted, drawn)
        valid = jnp.asarray(score.success)
        rmse, r2 = errors(jnp.column_stack(predicted[:3]), samples.numbers, valid)
        tiles = jnp.mean((repaired == samples.repaired).mean(axis=(1, 2)), where=valid)
        some = valid.any()
        return state._replace(
            ring=state.ring.add(samples, valid),
            rmse=jnp.where(some, rmse, state.rmse),
            r2=jnp.where(some, r2, state.r2),
            tiles=jnp.where(some, tiles, state.tiles),
        )

    def notes(self, search: Any) -> dict[str, jax.Array]:
        """Return what a run logs of the model of a search's state; NaN before the first fit."""
        state: ModelState = search.model
        heads = ["objective", "result", *(axis.name.replace(" ", "_") for axis in self._measures)]
        numbers = {f"loss_{stage}": value for stage, value in state.losses.items()}
        numbers |= {f"rmse_{head}": state.rmse[i] for i, head in enumerate(heads)}
        numbers |= {f"r2_{head}": state.r2[i] for i, head in enumerate(heads)}
        numbers |= {"tiles_right": state.tiles}
        fits = state.fitted.fits
        return {"fits": fits} | {
            number: jnp.where(fits > 0, value, jnp.nan) for number, value in numbers.items()
        }
