"""The algorithms by name and by the type of their settings."""

from typing import TYPE_CHECKING, Any

from qdenv.registry import Registry

if TYPE_CHECKING:  # a registry imports an algorithm, and qdax with it, when it is asked for one
    from qdenv.search.base import Algorithm, Problem

# Makers are called as make(config, problem) and return an `Algorithm`.
ALGORITHMS = Registry(
    "algorithm",
    "qdenv.algorithms",
    {
        "cma-mae": "qdenv.search.settings:CMA_MAE",
        "cma-me": "qdenv.search.settings:CMA_ME",
        "cma-mae-screened": "qdenv.search.settings:SCREENED",
        "map-elites": "qdenv.search.settings:MAP_ELITES",
        "cma-es": "qdenv.search.settings:CMA_ES",
        "random": "qdenv.search.settings:RANDOM_SEARCH",
        "dsage": "qdenv.search.dsage.settings:DSAGE",
    },
)


def make_algorithm(config: Any, problem: "Problem") -> "Algorithm":
    """Make the algorithm that `config` chooses.

    Args:
        config: settings of a registered algorithm, like `CmaMaeConfig`.
        problem: what is searched.

    Raises:
        InputError: no algorithm is registered for this type of config, or a setting is impossible.
    """
    return ALGORITHMS.make(config, problem)
