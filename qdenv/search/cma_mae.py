"""CMA-MAE, its special case CMA-ME, and CMA-ES with an archive beside it.

Fontaine and Nikolaidis 2023, "Covariance matrix adaptation MAP-annealing",
https://arxiv.org/abs/2205.10752; Fontaine, Togelius, Nikolaidis and Hoover 2020, "Covariance matrix
adaptation for the rapid illumination of behavior space", https://arxiv.org/abs/1912.02400; Hansen
2016, "The CMA evolution strategy: a tutorial", https://arxiv.org/abs/1604.00772.
"""

import math
from collections.abc import Mapping

import jax

from qdenv.search.base import (
    Algorithm,
    Problem,
    SearchState,
    StoredArchive,
    check_batch,
    plain_key,
    start_solution,
)
from qdenv.search.emitters import (
    RANKERS,
    SELECTIONS,
    Emitters,
    make_emitters,
    make_groups,
    restart_rule,
)
from qdenv.search.settings import CmaEsConfig, CmaMaeConfig
from qdenv.search.strategies import make_strategy
from qdenv.types import Array, Score, look_up


def emitters_of(config: CmaMaeConfig, start: jax.Array) -> Emitters:
    """Make the emitters a config describes, all starting at `start` (float [P])."""
    group = make_emitters(
        *make_strategy(config.strategy, start.shape[0], config.batch, config.sigma0),
        start,
        config.emitters,
        look_up(RANKERS, config.ranker, "ranker"),
        look_up(SELECTIONS, config.selection, "selection"),
        restart_rule(config.restart),
    )
    return make_groups(group, config.ahead + 1)


def cma_mae(config: CmaMaeConfig, problem: Problem, x0: Array | None = None) -> Algorithm:
    """Make CMA-MAE (Fontaine and Nikolaidis 2023), as pyribs' scheduler runs it.

    All E * b rows enter both archives as one batch; then every emitter ranks its own rows by
    how the learning archive received them, and restarts from an elite of that archive. All start at
    `x0` (float [P]; zeros where None). Raises InputError if a setting is unknown.
    """
    start = start_solution(x0, problem.solution_dim)
    emitters = emitters_of(config, start)
    batch_size = config.emitters * config.batch

    def init(key: jax.Array) -> SearchState:
        key, emitters_key = jax.random.split(plain_key(key))
        thresholds = config.learning_rate, config.threshold_min
        archives = StoredArchive.empty(problem, start, batch_size, thresholds)
        return SearchState(key, emitters.init(emitters_key), archives)

    def ask(state: SearchState) -> tuple[jax.Array, SearchState]:
        key, ask_key = jax.random.split(state.key)
        solutions, changed = emitters.ask(state.emitters, ask_key)
        return solutions, state._replace(key=key, emitters=changed)

    def tell(
        state: SearchState, solutions: Array, score: Score, extras: Mapping[str, Array]
    ) -> SearchState:
        solutions, score = check_batch(solutions, score)
        key, tell_key = jax.random.split(state.key)
        archives, insertion = state.archives.add(solutions, score, extras)
        # Rows are ranked against the archive before the batch, but restarts draw from the archive
        # that holds it: the order of pyribs' scheduler.
        rows = solutions, score, insertion
        changed = emitters.tell(state.emitters, tell_key, rows, archives)
        return SearchState(key, changed, archives)

    return Algorithm(
        init, ask, tell, lambda state: state.archives.dense(), batch_size, ahead=config.ahead
    )


def cma_es(config: CmaEsConfig, problem: Problem, x0: Array | None = None) -> Algorithm:
    """Make CMA-ES: emitters that rank by the objective and recombine the better half.

    The measures steer nothing here. All start at `x0` (float [P]; zeros where None).
    """
    # The archive has to be there, though nothing ranks by it: the plainest, an elitist one.
    settings = CmaMaeConfig(
        **vars(config), learning_rate=1.0, threshold_min=-math.inf, ranker="obj", selection="mu"
    )
    return cma_mae(settings, problem, x0)
