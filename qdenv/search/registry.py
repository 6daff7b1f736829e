"""The algorithms by name and by the type of their settings."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from qdenv.registry import Registry
from qdenv.types import Measure

if TYPE_CHECKING:  # a registry imports an algorithm, and qdax with it, when it is asked for one
    from qdenv.search.base import Algorithm

# Makers are called as make(config, solution_dim, measures, extras) and return an `Algorithm`.
ALGORITHMS = Registry(
    "algorithm",
    "qdenv.algorithms",
    {
        "cma-mae": "qdenv.search.settings:CMA_MAE",
        "cma-me": "qdenv.search.settings:CMA_ME",
        "map-elites": "qdenv.search.settings:MAP_ELITES",
        "cma-es": "qdenv.search.settings:CMA_ES",
        "random": "qdenv.search.settings:RANDOM_SEARCH",
    },
)


def make_algorithm(
    config: Any,
    solution_dim: int,
    measures: Sequence[Measure],
    extras: Mapping[str, Any] | None = None,
) -> "Algorithm":
    """Make the algorithm that `config` chooses.

    Args:
        config: settings of a registered algorithm, like `CmaMaeConfig`.
        solution_dim: P.
        measures: axes of the archives.
        extras: one example (shapes and dtypes) of what is stored beside each elite.

    Raises:
        InputError: no algorithm is registered for this type of config, or a setting is impossible.
    """
    return ALGORITHMS.make(config, solution_dim, measures, extras)
