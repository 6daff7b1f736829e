"""MAP-Elites with the Iso+LineDD variation, on an elitist or a soft archive.

Mouret and Clune 2015, "Illuminating search spaces by mapping elites",
https://arxiv.org/abs/1504.04909; Vassiliades and Mouret 2018, "Discovering the elite hypervolume
by leveraging interspecies correlation", https://arxiv.org/abs/1804.03906.
"""

from collections.abc import Mapping
from typing import NamedTuple

import jax
from qdax.core.emitters.mutation_operators import isoline_variation

from qdenv.search.archive import GridArchive
from qdenv.search.base import Algorithm, Problem, plain_key, received, start_solution
from qdenv.search.settings import MapElitesConfig
from qdenv.search.store import ROW, Store, StoredElites
from qdenv.search.threshold_archive import ThresholdArchive
from qdenv.types import Array, Score


class MapElitesState(NamedTuple):
    """State of MAP-Elites; one pytree."""

    key: jax.Array
    parents: ThresholdArchive  # judged by `Score.objective`
    result: GridArchive  # the best by `Score.result_objective`
    store: Store  # the solutions of both, which hold rows of it


def map_elites(
    config: MapElitesConfig,
    problem: Problem,
    x0: Array | None = None,
) -> Algorithm:
    """Make MAP-Elites (Mouret and Clune 2015) with Iso+LineDD (Vassiliades and Mouret 2018).

    A child is x_i + sigma_iso N(0, I) + sigma_line (x_j - x_i) N(0, 1) of two random elites;
    while there are none, both parents are `x0`.

    Args:
        config: the settings.
        problem: what is searched.
        x0: the parent while there is none, float [P]; zeros where None.

    Raises:
        InputError: a setting is out of range.
    """
    start = start_solution(x0, problem.solution_dim)
    batch_size = config.emitters * config.batch
    soft = config.learning_rate, config.threshold_min

    def init(key: jax.Array) -> MapElitesState:
        parents = ThresholdArchive.empty(ROW, problem.measures, None, *soft)
        result = GridArchive.empty(ROW, problem.measures, problem.extras)
        store = Store.empty(start, batch_size, parents, result)
        return MapElitesState(plain_key(key), parents, result, store)

    def ask(state: MapElitesState) -> tuple[jax.Array, MapElitesState]:
        key, pair_key, noise_key = jax.random.split(state.key, 3)
        elites = StoredElites(state.parents, state.store)
        pairs = elites.sample_solutions(pair_key, 2 * batch_size, start)
        first, second = pairs[:batch_size], pairs[batch_size:]
        children = isoline_variation(first, second, noise_key, config.sigma_iso, config.sigma_line)
        return children, state._replace(key=key)

    def tell(
        state: MapElitesState, solutions: Array, score: Score, extras: Mapping[str, Array]
    ) -> MapElitesState:
        solutions, score = received(solutions, score)
        rows = state.store.free_rows(batch_size)
        parents, _ = state.parents.insert(
            rows, score.objective, score.measures, success=score.success
        )
        result, _ = state.result.insert(
            rows, score.result_objective, score.measures, extras, score.success
        )
        cells = result.cells_of(score.measures)
        store = state.store.keep(rows, solutions, cells, parents, result)
        return MapElitesState(state.key, parents, result, store)

    def archive(state: MapElitesState) -> GridArchive:
        return StoredElites(state.result, state.store).dense()

    return Algorithm(init, ask, tell, archive, batch_size, ahead=config.ahead)
