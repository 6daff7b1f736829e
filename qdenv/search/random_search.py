"""Random search: independent Gaussian solutions, the archive kept passively."""

from collections.abc import Mapping
from typing import NamedTuple

import jax

from qdenv.search.archive import GridArchive
from qdenv.search.base import Algorithm, Problem, plain_key, received, start_solution
from qdenv.search.settings import RandomSearchConfig
from qdenv.search.store import ROW, Store, StoredElites
from qdenv.types import Array, Score


class RandomSearchState(NamedTuple):
    """State of random search; one pytree."""

    key: jax.Array
    result: GridArchive
    store: Store  # its solutions


def random_search(
    config: RandomSearchConfig,
    problem: Problem,
    x0: Array | None = None,
) -> Algorithm:
    """Make random search: every solution is drawn from N(x0, sigma^2 I).

    Args:
        config: the settings.
        problem: what is searched.
        x0: the centre, float [P]; zeros where None.

    Raises:
        InputError: a setting is out of range.
    """
    start = start_solution(x0, problem.solution_dim)

    def init(key: jax.Array) -> RandomSearchState:
        result = GridArchive.empty(ROW, problem.measures, problem.extras)
        return RandomSearchState(plain_key(key), result, Store.empty(start, config.batch, result))

    def ask(state: RandomSearchState) -> tuple[jax.Array, RandomSearchState]:
        key, noise_key = jax.random.split(state.key)
        noise = jax.random.normal(noise_key, (config.batch, problem.solution_dim), start.dtype)
        return start[None] + config.sigma * noise, state._replace(key=key)

    def tell(
        state: RandomSearchState, solutions: Array, score: Score, extras: Mapping[str, Array]
    ) -> RandomSearchState:
        solutions, score = received(solutions, score)
        rows = state.store.free_rows(config.batch)
        result, _ = state.result.insert(
            rows, score.result_objective, score.measures, extras, score.success
        )
        cells = result.cells_of(score.measures)
        store = state.store.keep(rows, solutions, cells, result)
        return state._replace(result=result, store=store)

    def archive(state: RandomSearchState) -> GridArchive:
        return StoredElites(state.result, state.store).dense()

    return Algorithm(init, ask, tell, archive, config.batch, ahead=config.ahead)
