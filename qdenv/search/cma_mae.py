"""CMA-MAE, its special case CMA-ME, and the search of evolution strategies that both are.

Fontaine and Nikolaidis 2023, "Covariance matrix adaptation MAP-annealing",
https://arxiv.org/abs/2205.10752; Fontaine, Togelius, Nikolaidis and Hoover 2020, "Covariance matrix
adaptation for the rapid illumination of behavior space", https://arxiv.org/abs/1912.02400.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax

from qdenv.search.archive import GridArchive
from qdenv.search.base import Algorithm, Problem, plain_key, received, start_solution
from qdenv.search.emitters import (
    RANKERS,
    SELECTIONS,
    Emitters,
    EmittersState,
    make_emitters,
    restart_rule,
)
from qdenv.search.settings import CmaMaeConfig
from qdenv.search.store import ROW, Store, StoredElites
from qdenv.search.strategies.registry import STRATEGIES
from qdenv.search.threshold_archive import ThresholdArchive
from qdenv.search.turns import TurnsState, take_turns
from qdenv.types import Array, Measure, Score, look_up


class CmaMaeState(NamedTuple):
    """State of CMA-MAE; one pytree."""

    key: jax.Array
    emitters: EmittersState | TurnsState
    learning: ThresholdArchive  # judged by `Score.objective`; steers the emitters
    result: GridArchive  # the best by `Score.result_objective`
    store: Store  # the solutions of both, which hold rows of it


def make_team(config: CmaMaeConfig, start: jax.Array) -> Emitters:
    """Make the emitters a config describes, all starting at `start` (float [P]).

    Raises:
        InputError: a setting is out of range or unknown.
    """
    make_strategy = look_up(STRATEGIES, config.strategy, "strategy")
    team = make_emitters(
        make_strategy(start.shape[0], config.batch, config.sigma0),
        start,
        config.emitters,
        config.batch,
        look_up(RANKERS, config.ranker, "ranker"),
        look_up(SELECTIONS, config.selection, "selection"),
        restart_rule(config.restart),
    )
    return take_turns(team, config.ahead + 1)


def new_learning_archive(
    config: CmaMaeConfig, solution: Any, measures: Sequence[Measure]
) -> ThresholdArchive:
    """Make the empty soft archive that steers the emitters (`solution`: one example)."""
    soft = config.learning_rate, config.threshold_min
    return ThresholdArchive.empty(solution, measures, None, *soft)


def cma_mae(
    config: CmaMaeConfig,
    problem: Problem,
    x0: Array | None = None,
) -> Algorithm:
    """Make CMA-MAE (Fontaine and Nikolaidis 2023), as pyribs' scheduler runs it.

    All E * b rows enter both archives as one batch; then every emitter ranks its own rows by
    what the learning archive said of them, and restarts from an elite of that archive.

    Args:
        config: the settings.
        problem: what is searched.
        x0: where all emitters start, float [P]; zeros where None.

    Raises:
        InputError: a setting is out of range or unknown.
    """
    start = start_solution(x0, problem.solution_dim)
    team = make_team(config, start)
    batch_size = config.emitters * config.batch

    def init(key: jax.Array) -> CmaMaeState:
        key, team_key = jax.random.split(plain_key(key))
        learning = new_learning_archive(config, ROW, problem.measures)
        result = GridArchive.empty(ROW, problem.measures, problem.extras)
        store = Store.empty(start, batch_size, learning, result)
        return CmaMaeState(key, team.init(team_key), learning, result, store)

    def ask(state: CmaMaeState) -> tuple[jax.Array, CmaMaeState]:
        key, ask_key = jax.random.split(state.key)
        solutions, emitters = team.ask(state.emitters, ask_key)
        return solutions, state._replace(key=key, emitters=emitters)

    def tell(
        state: CmaMaeState, solutions: Array, score: Score, extras: Mapping[str, Array]
    ) -> CmaMaeState:
        solutions, score = received(solutions, score)
        key, tell_key = jax.random.split(state.key)
        rows = state.store.free_rows(batch_size)
        learning, insertion = state.learning.insert(
            rows, score.objective, score.measures, success=score.success
        )
        # The learning archive may replace a better elite by a worse one: results need their own.
        result, _ = state.result.insert(
            rows, score.result_objective, score.measures, extras, score.success
        )
        cells = result.cells_of(score.measures)
        store = state.store.keep(rows, solutions, cells, learning, result)
        # All verdicts are older than the batch, but restarts draw from the archive that holds it:
        # the order of pyribs' scheduler.
        told = solutions, insertion, score.objective, score.success
        emitters = team.tell(state.emitters, tell_key, *told, StoredElites(learning, store))
        return CmaMaeState(key, emitters, learning, result, store)

    def archive(state: CmaMaeState) -> GridArchive:
        return StoredElites(state.result, state.store).dense()

    return Algorithm(init, ask, tell, archive, batch_size, ahead=config.ahead)
