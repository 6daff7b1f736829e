"""The settings of one evaluation: which domain, which generator, how often it is simulated."""

from dataclasses import dataclass, field
from typing import Any

from qdenv.domains.base import DOMAINS
from qdenv.generate.generator import GENERATORS
from qdenv.repair.settings import RepairConfig


@dataclass(frozen=True)
class EvaluationConfig:
    """What one evaluation does (Table 1 of the paper).

    Attributes:
        domain: settings of a registered domain; their type chooses it.
        generator: settings of a registered generator, likewise.
        simulations: simulations per layout N_e.
        alpha: weight of the similarity score in the objective.
        repair: limits of the repair.
    """

    domain: Any = field(default_factory=lambda: DOMAINS.config("warehouse-even"))
    generator: Any = field(default_factory=lambda: GENERATORS.config("nca"))
    simulations: int = 5
    alpha: float = 5.0
    repair: RepairConfig = field(default_factory=RepairConfig)
