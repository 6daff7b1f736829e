"""CMA-ES on the objective alone, with an archive kept passively.

Hansen 2016, "The CMA evolution strategy: a tutorial", https://arxiv.org/abs/1604.00772.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from qdenv.registry import Entry
from qdenv.search.base import Algorithm
from qdenv.search.cma_mae import CmaMaeConfig, cma_mae
from qdenv.types import Array, Measure


@dataclass(frozen=True)
class CmaEsConfig:
    """Settings of the single-objective search.

    Attributes:
        emitters: independent evolution strategies.
        batch: solutions of each strategy per iteration.
        sigma0: initial step size.
        restart: never (basic), when no cell improved, or every so many iterations. A strategy
            whose distribution is degenerate restarts anyway, from a random elite.
        strategy: a name of `STRATEGIES`.
    """

    emitters: int = 1
    batch: int = 50
    sigma0: float = 0.2
    restart: Literal["no_improvement", "basic"] | int = "basic"
    strategy: str = "sep"


def cma_es(
    config: CmaEsConfig,
    solution_dim: int,
    measures: Sequence[Measure],
    extras: Mapping[str, Any] | None = None,
    x0: Array | None = None,
) -> Algorithm:
    """Make CMA-ES: emitters that rank by the objective and recombine the better half.

    Args:
        config: the settings.
        solution_dim: P.
        measures: axes of the archive, which steers nothing here.
        extras: one example of what the archive stores beside each elite.
        x0: where all strategies start, float [P]; zeros where None.

    Raises:
        InputError: a setting is out of range or unknown.
    """
    settings = CmaMaeConfig(
        emitters=config.emitters,
        batch=config.batch,
        sigma0=config.sigma0,
        learning_rate=1.0,
        threshold_min=float("-inf"),
        ranker="obj",
        selection="mu",
        restart=config.restart,
        strategy=config.strategy,
    )
    return cma_mae(settings, solution_dim, measures, extras, x0)


CMA_ES = Entry(CmaEsConfig, cma_es)
