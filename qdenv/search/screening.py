"""CMA-MAE whose offspring a surrogate screens: of several per evaluation the most promising.

Known as preselection in evolution strategies, Jin 2011, "Surrogate-assisted evolutionary
computation: recent advances and future challenges", https://doi.org/10.1016/j.swevo.2011.05.001.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdenv.search.base import Algorithm, Problem, SearchState, check_batch, plain_key
from qdenv.search.cma_mae import cma_mae
from qdenv.search.model import Model, ModelState
from qdenv.search.settings import ScreenedConfig
from qdenv.types import Array, Extras, Score


class ScreenedState(NamedTuple):
    """State of the search; one pytree."""

    key: jax.Array
    inner: SearchState  # of CMA-MAE
    iteration: jax.Array  # int32, batches scored so far
    model: ModelState  # the surrogate


def screened(config: ScreenedConfig, problem: Problem, x0: Array | None = None) -> Algorithm:
    """Make CMA-MAE with screening, all emitters starting at `x0` (float [P]; zeros where None).

    Each place of a batch is drawn `screen` times by its emitter; the surrogate chooses the one that
    it expects to exceed the threshold of its cell by most. It is fitted every `refit` iterations;
    before the first fit nothing is screened. Raises InputError if solutions encode no layouts.
    """
    model = Model(config.surrogate, problem, "cma-mae-screened")
    inner = cma_mae(config, problem, x0)

    def init(key: jax.Array) -> ScreenedState:
        key, inner_key, net_key = jax.random.split(plain_key(key), 3)
        return ScreenedState(key, inner.init(inner_key), jnp.int32(0), model.init(net_key))

    def ask(state: ScreenedState) -> tuple[jax.Array, ScreenedState]:
        key, fit_key = jax.random.split(state.key)
        known = state.model
        due = (state.iteration % config.refit == 0) & (known.ring.known > 0)
        # The ring stays outside of the branch, whose results are copied.
        fitted, losses = jax.lax.cond(
            due,
            lambda: model.surrogate.fit(known.fitted, known.ring, fit_key),
            lambda: (known.fitted, known.losses),
        )
        inner_state, offspring = jax.lax.scan(
            lambda drawn, _: inner.ask(drawn)[::-1], state.inner, None, config.screen
        )
        learning = state.inner.archives.learning
        assert learning is not None  # CMA-MAE always has one

        def improvement(solutions: jax.Array) -> jax.Array:
            """Predict by how much solutions exceed the threshold of their cell, float [B]."""
            score = model.predict(fitted, solutions)
            threshold = learning.threshold_of(learning.cells_of(score.measures))
            # An empty cell of the elitist archive counts as one of threshold 0.
            value = score.objective - jnp.where(jnp.isneginf(threshold), 0.0, threshold)
            return jnp.where(score.success, value, -jnp.inf)

        # Before the first fit all are equal: the first offspring of each place is chosen.
        value = jax.lax.cond(
            fitted.fits > 0,
            lambda: jax.lax.map(improvement, offspring),
            lambda: jnp.zeros(offspring.shape[:2]),
        )
        chosen = jnp.take_along_axis(offspring, jnp.argmax(value, axis=0)[None, :, None], axis=0)[0]
        known = known._replace(fitted=fitted, losses=losses)
        return chosen, state._replace(key=key, inner=inner_state, model=known)

    def tell(state: ScreenedState, solutions: Array, score: Score, extras: Extras) -> ScreenedState:
        return state._replace(
            inner=inner.tell(state.inner, solutions, score, extras),
            iteration=state.iteration + 1,
            model=model.observe(state.model, *check_batch(solutions, score), extras),
        )

    return Algorithm(
        init, ask, tell, lambda state: inner.archive(state.inner), inner.batch_size, model.notes
    )
