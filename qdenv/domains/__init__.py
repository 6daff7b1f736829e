"""The domains: the only place that knows a domain's name."""

from qdenv.domains.base import Domain
from qdenv.domains.manufacturing import MANUFACTURING
from qdenv.domains.maze import MAZE_ENTROPY, MAZE_WALLS
from qdenv.domains.warehouse import WAREHOUSE_EVEN, WAREHOUSE_UNEVEN
from qdenv.types import look_up

_ALL = (WAREHOUSE_EVEN, WAREHOUSE_UNEVEN, MANUFACTURING, MAZE_WALLS, MAZE_ENTROPY)
DOMAINS: dict[str, Domain] = {domain.name: domain for domain in _ALL}


def find_domain(name: str) -> Domain:
    """Look a domain up by name.

    Raises:
        InputError: no domain has this name.
    """
    return look_up(DOMAINS, name, "domain")
