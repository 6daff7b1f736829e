"""The algorithms by name and by the type of their settings."""

from typing import TYPE_CHECKING, Any

from qdenv.registry import Entry, Registry
from qdenv.search import settings
from qdenv.types import InputError

if TYPE_CHECKING:  # a registry imports an algorithm, and qdax with it, when one is looked up
    from qdenv.search.base import Algorithm, Problem

# Makers are called as make(config, problem), or make(config, problem, x0) where a search begins
# at a solution x0, and return an `Algorithm`.
ALGORITHMS = Registry(
    "algorithm",
    "qdenv.algorithms",
    {
        "cma-mae": Entry(settings.CmaMaeConfig, "qdenv.search.cma_mae:cma_mae"),
        "cma-me": Entry(settings.CmaMeConfig, "qdenv.search.cma_mae:cma_mae"),
        "cma-mae-screened": Entry(settings.ScreenedConfig, "qdenv.search.screening:screened"),
        "map-elites": Entry(settings.MapElitesConfig, "qdenv.search.map_elites:map_elites"),
        "cma-es": Entry(settings.CmaEsConfig, "qdenv.search.cma_mae:cma_es"),
        "random": Entry(settings.RandomSearchConfig, "qdenv.search.map_elites:random_search"),
        "dsage": Entry(settings.DsageConfig, "qdenv.search.dsage:dsage"),
        "rearrange": Entry(settings.RearrangeConfig, "qdenv.search.rearrange:rearrange"),
    },
)


def make_algorithm(config: Any, problem: "Problem", x0: Any = None) -> "Algorithm":
    """Make the algorithm that `config` chooses, beginning at x0 (float [P]) unless that is None.

    Raises InputError if no algorithm is registered for this type of config, it takes no x0, or a
    setting is impossible.
    """
    if x0 is None:
        return ALGORITHMS.make(config, problem)
    if not ALGORITHMS.takes(config, 3):
        name = ALGORITHMS.name_of(config)
        raise InputError(f"{name} begins by itself: its maker takes no x0; leave start out")
    return ALGORITHMS.make(config, problem, x0)
