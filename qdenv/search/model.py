"""The surrogate of a search: it learns from true evaluations and reports its errors."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdenv.search.base import Problem
from qdenv.surrogate.samples import Ring, Samples
from qdenv.surrogate.settings import SurrogateConfig
from qdenv.surrogate.surrogate import Fitted, Surrogate, errors
from qdenv.types import Array, Encoding, InputError, Score


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


class Model(NamedTuple):
    """The surrogate of a search as a record of functions."""

    encoding: Encoding  # of the solutions
    surrogate: Surrogate
    init: Callable[[jax.Array], ModelState]  # consumes a key
    # (fitted, solutions [B, P]) -> their predicted `Score` with leading axis B
    predict: Callable[[Fitted, jax.Array], Score]
    # (state, solutions float [B, P], `Score`, extras), the last two as `Algorithm.tell` has them ->
    # state: the errors on this batch are measured, and its successes can be learnt from
    observe: Callable[[ModelState, jax.Array, Score, Mapping[str, Array]], ModelState]
    notes: Callable[[ModelState], dict[str, jax.Array]]  # what a run logs; NaN before the first fit


def make_model(config: SurrogateConfig, problem: Problem, name: str) -> Model:
    """Make the surrogate of a search; `name` is that of its algorithm, for messages.

    Raises InputError if solutions are nothing but numbers, or a setting is impossible.
    """
    encoding, measures = problem.encoding, problem.measures
    if encoding is None:
        raise InputError(f"{name} learns from layouts: the solutions of this problem encode none")
    surrogate = Surrogate(config, encoding, len(measures))

    def init(key: jax.Array) -> ModelState:
        zeros = jnp.zeros(surrogate.heads)
        return ModelState(
            fitted=surrogate.init(key),
            ring=Ring.empty(config.samples, encoding.shape, surrogate.heads),
            losses={stage: jnp.float32(0) for stage in surrogate.stages},
            rmse=zeros,
            r2=zeros,
            tiles=jnp.float32(0),
        )

    def predict(fitted: Fitted, solutions: jax.Array) -> Score:
        return surrogate.predict(fitted, encoding.draw(solutions.astype(jnp.float32))).score

    def observe(
        state: ModelState, solutions: jax.Array, score: Score, extras: Mapping[str, Array]
    ) -> ModelState:
        drawn = encoding.draw(solutions)
        samples = Samples(
            drawn,
            jnp.asarray(extras["repaired"]) if encoding.repairs else drawn,
            jnp.asarray(extras["usage"]) if encoding.usage else jnp.zeros(drawn.shape),
            _numbers(score),
        )
        # Predicted before it is learnt from: the errors are those on unseen layouts.
        prediction, valid = surrogate.predict(state.fitted, drawn), jnp.asarray(score.success)
        rmse, r2 = errors(_numbers(prediction.score), samples.numbers, valid)
        alike = (prediction.repaired == samples.repaired).mean(axis=(1, 2))
        tiles = jnp.mean(alike, where=valid)
        some = valid.any()
        return state._replace(
            ring=state.ring.add(samples, valid),
            rmse=jnp.where(some, rmse, state.rmse),
            r2=jnp.where(some, r2, state.r2),
            tiles=jnp.where(some, tiles, state.tiles),
        )

    def notes(state: ModelState) -> dict[str, jax.Array]:
        heads = ["objective", "result", *(axis.name.replace(" ", "_") for axis in measures)]
        numbers = {f"loss_{stage}": value for stage, value in state.losses.items()}
        numbers |= {f"rmse_{head}": state.rmse[i] for i, head in enumerate(heads)}
        numbers |= {f"r2_{head}": state.r2[i] for i, head in enumerate(heads)}
        numbers |= {"tiles_right": state.tiles}
        fits = state.fitted.fits
        return {"fits": fits} | {
            number: jnp.where(fits > 0, value, jnp.nan) for number, value in numbers.items()
        }

    return Model(encoding, surrogate, init, predict, observe, notes)


def _numbers(score: Score) -> jax.Array:
    """Return what a surrogate predicts as one array, float [B, heads]."""
    heads = [score.objective[:, None], score.result_objective[:, None], score.measures]
    return jnp.concatenate(heads, axis=1)
