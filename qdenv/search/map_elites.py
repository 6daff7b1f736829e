"""MAP-Elites with the Iso+LineDD variation, on an elitist or a soft archive; random search.

Mouret and Clune 2015, "Illuminating search spaces by mapping elites",
https://arxiv.org/abs/1504.04909; Vassiliades and Mouret 2018, "Discovering the elite hypervolume
by leveraging interspecies correlation", https://arxiv.org/abs/1804.03906.
"""

from collections.abc import Callable

import jax
from qdax.core.emitters.mutation_operators import isoline_variation

from qdenv.search.base import (
    Algorithm,
    Problem,
    SearchState,
    StoredArchive,
    check_batch,
    plain_key,
    start_solution,
)
from qdenv.search.settings import MapElitesConfig, RandomSearchConfig
from qdenv.types import Array, Extras, Score


def map_elites(config: MapElitesConfig, problem: Problem, x0: Array | None = None) -> Algorithm:
    """Make MAP-Elites (Mouret and Clune 2015) with Iso+LineDD (Vassiliades and Mouret 2018).

    A child is x_i + sigma_iso N(0, I) + sigma_line (x_j - x_i) N(0, 1) of two random elites;
    while there are none, both parents are `x0` (float [P]; zeros where None).
    """
    start = start_solution(x0, problem.solution_dim)
    batch_size = config.emitters * config.batch
    thresholds = config.learning_rate, config.threshold_min

    def ask(state: SearchState) -> tuple[jax.Array, SearchState]:
        key, pair_key, noise_key = jax.random.split(state.key, 3)
        pairs = state.archives.sample_solutions(pair_key, 2 * batch_size, start)
        first, second = pairs[:batch_size], pairs[batch_size:]
        children = isoline_variation(first, second, noise_key, config.sigma_iso, config.sigma_line)
        return children, state._replace(key=key)

    return _passive(ask, problem, start, batch_size, config.ahead, thresholds)


def random_search(
    config: RandomSearchConfig, problem: Problem, x0: Array | None = None
) -> Algorithm:
    """Make random search: every solution is drawn from N(x0, sigma^2 I); x0 is zeros where None."""
    start = start_solution(x0, problem.solution_dim)

    def ask(state: SearchState) -> tuple[jax.Array, SearchState]:
        key, noise_key = jax.random.split(state.key)
        noise = jax.random.normal(noise_key, (config.batch, problem.solution_dim), start.dtype)
        return start[None] + config.sigma * noise, state._replace(key=key)

    return _passive(ask, problem, start, config.batch, config.ahead)


def _passive(
    ask: Callable[[SearchState], tuple[jax.Array, SearchState]],
    problem: Problem,
    start: jax.Array,
    batch_size: int,
    ahead: int,
    thresholds: tuple[float, float] | None = None,
) -> Algorithm:
    """Make an algorithm whose only memory is its archives; the learning one holds the parents."""

    def init(key: jax.Array) -> SearchState:
        archives = StoredArchive.empty(problem, start, batch_size, thresholds)
        return SearchState(plain_key(key), None, archives)

    def tell(state: SearchState, solutions: Array, score: Score, extras: Extras) -> SearchState:
        solutions, score = check_batch(solutions, score)
        archives, _ = state.archives.add(solutions, score, extras)
        return state._replace(archives=archives)

    return Algorithm(init, ask, tell, lambda state: state.archives.dense(), batch_size, ahead=ahead)
