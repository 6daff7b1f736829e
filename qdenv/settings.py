"""The settings of one evaluation: which domain, which generator, how often it is simulated."""

from dataclasses import dataclass, field
from typing import Any

from qdenv.domains.base import DOMAINS
from qdenv.generators import GENERATORS
from qdenv.ranges import FiniteFloat, PositiveInt, Ranged
from qdenv.repairs.settings import RepairConfig


@dataclass(frozen=True)
class EvaluationConfig(Ranged):
    """What one evaluation does (Table 1 of the paper)."""

    # settings of a registered domain; their type chooses it
    domain: Any = field(default_factory=lambda: DOMAINS.config("warehouse-even"))
    # settings of a registered generator; their type chooses it
    generator: Any = field(default_factory=lambda: GENERATORS.config("nca"))
    simulations: PositiveInt = 5  # simulations of each layout, N_e in the paper
    alpha: FiniteFloat = 5.0  # weight of the similarity of drawn and repaired layout
    repair: RepairConfig = field(default_factory=RepairConfig)  # limits of the repair
