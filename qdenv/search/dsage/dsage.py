"""The outer loop of DSAGE: evaluate truly, learn, search the surrogate, take what it found.

Bhatt, Tjanaka, Fontaine and Nikolaidis 2022, "Deep surrogate assisted generation of environments",
https://arxiv.org/abs/2206.04199, as Zhang et al. 2023 use it for layouts.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qdenv.search.archive import GridArchive
from qdenv.search.base import Algorithm, Drawing, Problem, plain_key, received
from qdenv.search.dsage.downsample import block_of_cells, blocks_along, choose_waiting
from qdenv.search.dsage.inner import search_surrogate
from qdenv.search.dsage.settings import DsageConfig
from qdenv.search.dsage.tiles import random_tiles
from qdenv.search.observed import aspect_of, drawing_of, samples_of
from qdenv.search.store import ROW, Store, StoredElites
from qdenv.surrogate.report import Report, blank_report, report_errors
from qdenv.surrogate.samples import Ring
from qdenv.surrogate.surrogate import Aspect, Fitted, Surrogate, make_surrogate
from qdenv.types import Array, InputError, Score


class DsageState(NamedTuple):
    """State of DSAGE; one pytree."""

    key: jax.Array
    queue: jax.Array  # int8 [Q, P], solutions to be evaluated truly, the last ones first
    waiting: jax.Array  # int32, how many of them still are
    fitted: Fitted  # the surrogate
    ring: Ring  # true evaluations to learn from
    report: Report  # how the surrogate does
    result: GridArchive  # the best by `Score.result_objective`
    store: Store  # its solutions


class Outer(NamedTuple):
    """What the outer loop is made of, fixed while it runs."""

    config: DsageConfig
    problem: Problem
    drawing: Drawing
    surrogate: Surrogate
    block: np.ndarray  # int32 [C], the block in which each cell of the archive lies
    first: int  # random solutions
    room: int  # Q


def dsage(config: DsageConfig, problem: Problem, x0: Array | None = None) -> Algorithm:
    """Make DSAGE: random solutions first, then what the surrogate holds for the best.

    When all that was waiting is evaluated, `ask` fits the surrogate to the newest evaluations,
    fills a fresh archive by its predictions, and lets one elite of every block of cells wait, and
    as many more as fill the last batch.

    Args:
        config: the settings.
        problem: what is searched; its drawing says how many tiles a parameter may name.
        x0: must be None: there is no one solution from which to start.

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
    blocks = blocks_along(problem.measures, config.downsample)
    first = _whole_batches(config.initial, config.batch)
    aspect = aspect_of(problem, drawing)
    outer = Outer(
        config,
        problem,
        drawing,
        make_surrogate(config.surrogate, aspect),
        block_of_cells(problem.measures, blocks),
        first,
        max(first, _whole_batches(math.prod(blocks), config.batch)),
    )

    def tell(
        state: DsageState, solutions: Array, score: Score, extras: Mapping[str, Array]
    ) -> DsageState:
        return _take_in(outer, state, *received(solutions, score), extras)

    return Algorithm(
        init=lambda key: _begin(outer, aspect, key),
        ask=lambda state: _ask(outer, state),
        tell=tell,
        archive=lambda state: StoredElites(state.result, state.store).dense(),
        batch_size=config.batch,
        notes=lambda state: state.report.columns(problem.measures, state.fitted.fits),
    )


def _whole_batches(count: int, batch: int) -> int:
    return -(-count // batch) * batch


def _begin(outer: Outer, aspect: Aspect, key: jax.Array) -> DsageState:
    problem, choices = outer.problem, outer.drawing.choices
    key, queue_key, net_key = jax.random.split(plain_key(key), 3)
    result = GridArchive.empty(ROW, problem.measures, problem.extras)
    blank = jnp.zeros(problem.solution_dim, jnp.float32)
    heads, kept = outer.surrogate.heads, outer.config.surrogate.samples
    return DsageState(
        key=key,
        queue=random_tiles(queue_key, outer.room, problem.solution_dim, choices),
        waiting=jnp.int32(outer.first),
        fitted=outer.surrogate.init(net_key),
        ring=Ring.empty(kept, outer.drawing.shape, heads),
        report=blank_report(aspect),
        result=result,
        store=Store.empty(blank, outer.config.batch, result),
    )


def _ask(outer: Outer, state: DsageState) -> tuple[jax.Array, DsageState]:
    key, think_key = jax.random.split(state.key)
    batch = outer.config.batch

    def think() -> tuple:
        return _think(outer, state, think_key)

    def go_on() -> tuple:
        return state.fitted, state.report, state.queue, state.waiting

    fitted, report, queue, waiting = jax.lax.cond(state.waiting == 0, think, go_on)
    rows = jax.lax.dynamic_slice_in_dim(queue, waiting - batch, batch)
    asked = state._replace(key=key, fitted=fitted, report=report, queue=queue, waiting=waiting)
    return rows.astype(jnp.float32), asked


def _think(outer: Outer, state: DsageState, key: jax.Array) -> tuple:
    """Learn, search the surrogate, and choose what waits."""
    config, problem, drawing = outer.config, outer.problem, outer.drawing
    fit_key, inner_key, queue_key, fresh_key = jax.random.split(key, 4)
    fitted, losses = outer.surrogate.fit(state.fitted, state.ring, fit_key)

    def predict(solutions: jax.Array) -> Score:
        drawn = drawing.draw(solutions.astype(jnp.float32))
        return outer.surrogate.predict(fitted, drawn).score

    found = search_surrogate(config, problem, drawing.choices, predict, inner_key)
    fresh = random_tiles(fresh_key, outer.room, problem.solution_dim, drawing.choices)
    queue, waiting = choose_waiting(queue_key, found, outer.block, fresh, config.batch)
    return fitted, state.report._replace(losses=losses), queue, waiting


def _take_in(
    outer: Outer,
    state: DsageState,
    solutions: jax.Array,
    score: Score,
    extras: Mapping[str, Array],
) -> DsageState:
    """Put a batch into the archive and the ring, after a look at what was thought of it."""
    samples, success = (
        samples_of(outer.drawing, solutions, score, extras),
        jnp.asarray(score.success),
    )
    prediction = outer.surrogate.predict(state.fitted, samples.drawn)
    rows = state.store.free_rows(outer.config.batch)
    told = score.result_objective, score.measures, extras, success
    result, _ = state.result.insert(rows, *told)
    store = state.store.keep(rows, solutions, result.cells_of(score.measures), result)
    return state._replace(
        waiting=state.waiting - outer.config.batch,
        ring=state.ring.add(samples, success),
        report=report_errors(state.report, prediction, samples, success),
        result=result,
        store=store,
    )
