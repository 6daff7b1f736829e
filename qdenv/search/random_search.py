"""Random search: independent Gaussian solutions, the archive kept passively."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax

from qdenv.registry import Entry
from qdenv.search.archive import GridArchive
from qdenv.search.base import Algorithm, plain_key, positive, received, start_solution
from qdenv.types import Array, Measure, Score


@dataclass(frozen=True)
class RandomSearchConfig:
    """Settings of random search.

    Attributes:
        batch: solutions per iteration.
        sigma: standard deviation of every parameter.
    """

    batch: int = 50
    sigma: float = 0.2


class RandomSearchState(NamedTuple):
    """State of random search; one pytree."""

    key: jax.Array
    result: GridArchive


def random_search(
    config: RandomSearchConfig,
    solution_dim: int,
    measures: Sequence[Measure],
    extras: Mapping[str, Any] | None = None,
    x0: Array | None = None,
) -> Algorithm:
    """Make random search: every solution is drawn from N(x0, sigma^2 I).

    Args:
        config: the settings.
        solution_dim: P.
        measures: axes of the archives.
        extras: one example of what the result archive stores beside each elite.
        x0: the centre, float [P]; zeros where None.

    Raises:
        InputError: a setting is out of range.
    """
    positive(batch=config.batch, sigma=config.sigma)
    start = start_solution(x0, solution_dim)

    def init(key: jax.Array) -> RandomSearchState:
        return RandomSearchState(plain_key(key), GridArchive.empty(start, measures, extras))

    def ask(state: RandomSearchState) -> tuple[jax.Array, RandomSearchState]:
        key, noise_key = jax.random.split(state.key)
        noise = jax.random.normal(noise_key, (config.batch, solution_dim), start.dtype)
        return start[None] + config.sigma * noise, state._replace(key=key)

    def tell(
        state: RandomSearchState, solutions: Array, score: Score, extras: Mapping[str, Array]
    ) -> RandomSearchState:
        solutions, score = received(solutions, score)
        result, _ = state.result.insert(
            solutions, score.result_objective, score.measures, extras, score.success
        )
        return state._replace(result=result)

    return Algorithm(init, ask, tell, lambda state: state.result, config.batch)


RANDOM_SEARCH = Entry(RandomSearchConfig, random_search)
