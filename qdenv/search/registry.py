"""The algorithms by name; a user's own is one more entry of `ALGORITHMS`."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from qdenv.search.base import Algorithm
from qdenv.search.cma_es import CmaEsConfig, cma_es
from qdenv.search.cma_mae import CmaMaeConfig, CmaMeConfig, cma_mae
from qdenv.search.map_elites import MapElitesConfig, map_elites
from qdenv.search.random_search import RandomSearchConfig, random_search
from qdenv.types import InputError


class Entry(NamedTuple):
    """One registered algorithm.

    Attributes:
        config: frozen dataclass of its settings, with defaults for all of them.
        make: (config, solution_dim, measures, extras) -> `Algorithm`.
    """

    config: type
    make: Callable[..., Algorithm]


ALGORITHMS: dict[str, Entry] = {
    "cma-mae": Entry(CmaMaeConfig, cma_mae),
    "cma-me": Entry(CmaMeConfig, cma_mae),
    "map-elites": Entry(MapElitesConfig, map_elites),
    "cma-es": Entry(CmaEsConfig, cma_es),
    "random": Entry(RandomSearchConfig, random_search),
}


def make_algorithm(
    config: Any,
    solution_dim: int,
    measures: Sequence[Any],
    extras: Mapping[str, Any] | None = None,
) -> Algorithm:
    """Make the algorithm that a config object belongs to.

    Raises:
        InputError: no registered algorithm has this type of config.
    """
    for entry in ALGORITHMS.values():
        if type(config) is entry.config:
            return entry.make(config, solution_dim, measures, extras)
    raise InputError(
        f"no algorithm is registered for {type(config).__name__}: choose from "
        f"{', '.join(ALGORITHMS)}"
    )
