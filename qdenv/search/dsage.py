"""The outer loop of DSAGE: evaluate truly, learn, search the surrogate, take its best.

Bhatt, Tjanaka, Fontaine and Nikolaidis 2022, "Deep surrogate assisted generation of environments",
https://arxiv.org/abs/2206.04199, as Zhang et al. 2023 use it for layouts.
"""

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qdenv.search.base import Algorithm, Problem, StoredArchive, plain_key, received
from qdenv.search.settings import DsageConfig
from qdenv.search.surrogate_samples import aspect_of, drawing_of, samples_of
from qdenv.search.surrogate_search import (
    block_of_cells,
    blocks_along,
    choose_waiting,
    random_tiles,
    search_surrogate,
)
from qdenv.surrogate.samples import Ring
from qdenv.surrogate.surrogate import (
    Fitted,
    Report,
    Surrogate,
    blank_report,
    make_surrogate,
    report_errors,
)
from qdenv.types import Array, InputError, Score


class DsageState(NamedTuple):
    """State of DSAGE; one pytree."""

    key: jax.Array
    queue: jax.Array  # int8 [Q, P], solutions to be evaluated truly, the last ones first
    waiting: jax.Array  # int32, how many of them still are
    fitted: Fitted  # the surrogate
    ring: Ring  # true evaluations to learn from
    report: Report  # losses and errors of the surrogate
    archives: StoredArchive  # of true evaluations, without a learning archive


def dsage(config: DsageConfig, problem: Problem, x0: Array | None = None) -> Algorithm:
    """Make DSAGE: random solutions first, then those that the surrogate rates best.

    When all that was waiting is evaluated, `ask` fits the surrogate to the newest evaluations,
    fills a fresh archive by its predictions, and lets one elite of every block of cells wait, and
    as many more as fill the last batch.

    Args:
        config: the settings.
        problem: what is searched; its drawing has the number of tiles a parameter may name.
        x0: must be None: a search of tiles begins with random ones.

    Raises:
        InputError: solutions are no tiles, or a setting is out of range.
    """
    drawing = drawing_of(problem, "dsage")
    if drawing.choices < 2:
        raise InputError(
            "dsage searches tiles, one per parameter: its generator is direct, not an automaton"
        )
    if x0 is not None:
        raise InputError("dsage begins with random solutions: leave the start out")
    batch, choices = config.batch, drawing.choices
    blocks = blocks_along(problem.measures, config.downsample)
    block = block_of_cells(problem.measures, blocks)
    first = -(-config.initial // batch) * batch  # whole batches
    room = max(first, -(-math.prod(blocks) // batch) * batch)  # Q
    aspect = aspect_of(problem, drawing)
    surrogate = make_surrogate(config.surrogate, aspect)
    refill = _make_refill(config, problem, surrogate, block, room)

    def init(key: jax.Array) -> DsageState:
        key, queue_key, net_key = jax.random.split(plain_key(key), 3)
        blank = jnp.zeros(problem.solution_dim, jnp.float32)
        return DsageState(
            key=key,
            queue=random_tiles(queue_key, room, problem.solution_dim, choices),
            waiting=jnp.int32(first),
            fitted=surrogate.init(net_key),
            ring=Ring.empty(config.surrogate.samples, drawing.shape, surrogate.heads),
            report=blank_report(aspect),
            archives=StoredArchive.empty(problem, blank, batch),
        )

    def ask(state: DsageState) -> tuple[jax.Array, DsageState]:
        key, refill_key = jax.random.split(state.key)
        fitted, report, queue, waiting = jax.lax.cond(
            state.waiting == 0,
            lambda: refill(state.fitted, state.ring, state.report, refill_key),
            lambda: (state.fitted, state.report, state.queue, state.waiting),
        )
        rows = jax.lax.dynamic_slice_in_dim(queue, waiting - batch, batch)
        state = state._replace(key=key, fitted=fitted, report=report, queue=queue, waiting=waiting)
        return rows.astype(jnp.float32), state

    def tell(
        state: DsageState, solutions: Array, score: Score, extras: Mapping[str, Array]
    ) -> DsageState:
        solutions, score = received(solutions, score)
        samples = samples_of(drawing, solutions, score, extras)
        success = jnp.asarray(score.success)
        # Predicted before it is learnt from: the report is about unseen layouts.
        prediction = surrogate.predict(state.fitted, samples.drawn)
        archives, _ = state.archives.add(solutions, score, extras)
        return state._replace(
            waiting=state.waiting - batch,
            ring=state.ring.add(samples, success),
            report=report_errors(state.report, prediction, samples, success),
            archives=archives,
        )

    return Algorithm(
        init,
        ask,
        tell,
        archive=lambda state: state.archives.dense(),
        batch_size=batch,
        notes=lambda state: state.report.columns(problem.measures, state.fitted.fits),
    )


def _make_refill(
    config: DsageConfig, problem: Problem, surrogate: Surrogate, block: np.ndarray, room: int
) -> Callable[..., tuple[Fitted, Report, jax.Array, jax.Array]]:
    """Make the function that learns, searches the surrogate, and chooses the solutions that wait.

    Returns:
        (fitted, ring, report, key) -> (fitted, report, queue, waiting).
    """
    drawing = drawing_of(problem, "dsage")

    def refill(
        fitted: Fitted, ring: Ring, report: Report, key: jax.Array
    ) -> tuple[Fitted, Report, jax.Array, jax.Array]:
        fit_key, inner_key, queue_key, fresh_key = jax.random.split(key, 4)
        fitted, losses = surrogate.fit(fitted, ring, fit_key)

        def predict(solutions: jax.Array) -> Score:
            drawn = drawing.draw(solutions.astype(jnp.float32))
            return surrogate.predict(fitted, drawn).score

        predicted = search_surrogate(config, problem, drawing.choices, predict, inner_key)
        fresh = random_tiles(fresh_key, room, problem.solution_dim, drawing.choices)
        queue, waiting = choose_waiting(queue_key, predicted, block, fresh, config.batch)
        return fitted, report._replace(losses=losses), queue, waiting

    return refill
