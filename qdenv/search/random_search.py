"""Random search: independent Gaussian solutions, the archive kept passively."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from qdenv.search.archive import GridArchive
from qdenv.search.base import Algorithm, plain_key, positive, start_solution, usable
from qdenv.types import Array, Score


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

    key: Array
    result: GridArchive


def random_search(
    config: RandomSearchConfig,
    solution_dim: int,
    measures: Sequence[Any],
    extras: Mapping[str, Any] | None = None,
    x0: Any = None,
) -> Algorithm:
    """Make random search: every solution is drawn from N(x0, sigma^2 I).

    Args:
        config: the settings.
        solution_dim: P.
        measures: records with ``name, low, high, cells``.
        extras: one example of what the result archive stores beside each elite.
        x0: the centre, float [P]; zeros where None.

    Raises:
        InputError: a setting is out of range.
    """
    positive(batch=config.batch, sigma=config.sigma)
    start = start_solution(x0, solution_dim)

    def init(key: Array) -> RandomSearchState:
        return RandomSearchState(plain_key(key), GridArchive.empty(start, measures, extras))

    def ask(state: RandomSearchState) -> tuple[Array, RandomSearchState]:
        key, noise_key = jax.random.split(state.key)
        noise = jax.random.normal(noise_key, (config.batch, solution_dim), start.dtype)
        return start + config.sigma * noise, state._replace(key=key)

    def tell(
        state: RandomSearchState, solutions: Array, score: Score, extras: Mapping[str, Array]
    ) -> RandomSearchState:
        score, solutions = jax.tree.map(jnp.asarray, (score, solutions))
        result, _ = state.result.insert(
            solutions,
            score.result_objective,
            score.measures,
            extras,
            usable(solutions, score),
        )
        return state._replace(result=result)

    return Algorithm(init, ask, tell, lambda state: state.result, config.batch)
