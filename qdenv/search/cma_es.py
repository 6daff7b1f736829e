"""CMA-ES on the objective alone, with an archive kept passively.

Hansen 2016, "The CMA evolution strategy: a tutorial", https://arxiv.org/abs/1604.00772.
"""

from qdenv.search.base import Algorithm, Problem
from qdenv.search.cma_mae import cma_mae
from qdenv.search.settings import CmaEsConfig, CmaMaeConfig
from qdenv.types import Array


def cma_es(
    config: CmaEsConfig,
    problem: Problem,
    x0: Array | None = None,
) -> Algorithm:
    """Make CMA-ES: emitters that rank by the objective and recombine the better half.

    Args:
        config: the settings.
        problem: what is searched; the measures steer nothing here.
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
        ahead=config.ahead,
    )
    return cma_mae(settings, problem, x0)
