"""CMA-MAE whose offspring a surrogate screens: of several per evaluation the most promising.

Known as preselection in evolution strategies, Jin 2011, "Surrogate-assisted evolutionary
computation: recent advances and future challenges", https://doi.org/10.1016/j.swevo.2011.05.001.
"""

from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdenv.search.base import Algorithm, Problem, plain_key, received
from qdenv.search.cma_mae import CmaMaeState, cma_mae
from qdenv.search.settings import ScreenedConfig
from qdenv.search.surrogate_samples import aspect_of, drawing_of, samples_of
from qdenv.surrogate.samples import Ring
from qdenv.surrogate.surrogate import (
    Fitted,
    Report,
    blank_report,
    make_surrogate,
    report_errors,
)
from qdenv.types import Array, Score


class ScreenedState(NamedTuple):
    """State of the search; one pytree."""

    key: jax.Array
    inner: CmaMaeState
    iteration: jax.Array  # int32, batches scored so far
    fitted: Fitted  # the surrogate
    ring: Ring  # true evaluations to learn from
    report: Report  # losses and errors of the surrogate


def screened(config: ScreenedConfig, problem: Problem, x0: Array | None = None) -> Algorithm:
    """Make CMA-MAE with screening.

    Each place of a batch is drawn `screen` times by its emitter; the surrogate chooses the one that
    it expects to exceed the threshold of its cell by most. It is fitted every `refit` iterations;
    before the first fit nothing is screened.

    Args:
        config: the settings.
        problem: what is searched, with a drawing.
        x0: where all emitters start, float [P]; zeros where None.

    Raises:
        InputError: a setting is out of range or unknown, or solutions have no drawing.
    """
    drawing = drawing_of(problem, "cma-mae-screened")
    aspect = aspect_of(problem, drawing)
    surrogate = make_surrogate(config.surrogate, aspect)
    inner = cma_mae(config, problem, x0)

    def init(key: jax.Array) -> ScreenedState:
        key, inner_key, net_key = jax.random.split(plain_key(key), 3)
        ring = Ring.empty(config.surrogate.samples, drawing.shape, surrogate.heads)
        fitted, report = surrogate.init(net_key), blank_report(aspect)
        return ScreenedState(key, inner.init(inner_key), jnp.int32(0), fitted, ring, report)

    def ask(state: ScreenedState) -> tuple[jax.Array, ScreenedState]:
        key, fit_key = jax.random.split(state.key)
        due = (state.iteration % config.refit == 0) & (state.ring.known > 0)

        def learn() -> tuple[Fitted, Report]:
            fitted, losses = surrogate.fit(state.fitted, state.ring, fit_key)
            return fitted, state.report._replace(losses=losses)

        fitted, report = jax.lax.cond(due, learn, lambda: (state.fitted, state.report))

        def draw(inner_state: CmaMaeState, _: None) -> tuple[CmaMaeState, jax.Array]:
            solutions, inner_state = inner.ask(inner_state)
            return inner_state, solutions

        inner_state, offspring = jax.lax.scan(draw, state.inner, None, config.screen)
        learning = state.inner.archives.learning
        assert learning is not None  # CMA-MAE always has one

        def improvement(solutions: jax.Array) -> jax.Array:
            """Predict by how much solutions exceed the threshold of their cell, float [B]."""
            score = surrogate.predict(fitted, drawing.draw(solutions)).score
            threshold = learning.threshold_of(learning.cells_of(score.measures))
            # An empty cell of the elitist archive counts as one of threshold 0.
            value = score.objective - jnp.where(jnp.isneginf(threshold), 0.0, threshold)
            return jnp.where(score.success, value, -jnp.inf)

        # Before the first fit all are equal: the first offspring of each place goes on.
        value = jax.lax.cond(
            fitted.fits > 0,
            lambda: jax.lax.map(improvement, offspring),
            lambda: jnp.zeros(offspring.shape[:2]),
        )
        best = jnp.argmax(value, axis=0)
        chosen = jnp.take_along_axis(offspring, best[None, :, None], axis=0)[0]
        return chosen, state._replace(key=key, inner=inner_state, fitted=fitted, report=report)

    def tell(
        state: ScreenedState, solutions: Array, score: Score, extras: Mapping[str, Array]
    ) -> ScreenedState:
        drawn, usable = received(solutions, score)
        samples, success = samples_of(drawing, drawn, usable, extras), jnp.asarray(usable.success)
        prediction = surrogate.predict(state.fitted, samples.drawn)
        return state._replace(
            inner=inner.tell(state.inner, solutions, score, extras),
            iteration=state.iteration + 1,
            ring=state.ring.add(samples, success),
            report=report_errors(state.report, prediction, samples, success),
        )

    return Algorithm(
        init,
        ask,
        tell,
        lambda state: inner.archive(state.inner),
        inner.batch_size,
        lambda state: state.report.columns(problem.measures, state.fitted.fits),
    )
