"""The settings of one evaluation: which domain, which generator, how often it is simulated."""

import math
from dataclasses import dataclass, field
from typing import Any

from qdenv.domains.base import DOMAINS
from qdenv.generate.generator import GENERATORS
from qdenv.repair.settings import RepairConfig
from qdenv.types import InputError


@dataclass(frozen=True)
class EvaluationConfig:
    """What one evaluation does (Table 1 of the paper).

    Attributes:
        domain: settings of a registered domain; their type chooses it.
        generator: settings of a registered generator, likewise.
        simulations: how often each layout is simulated, N_e.
        alpha: how much it counts that the repair changes little.
        repair: limits of the repair.
    """

    domain: Any = field(default_factory=lambda: DOMAINS.config("warehouse-even"))
    generator: Any = field(default_factory=lambda: GENERATORS.config("nca"))
    simulations: int = 5
    alpha: float = 5.0
    repair: RepairConfig = field(default_factory=RepairConfig)

    def __post_init__(self) -> None:
        """Refuse numbers that score nothing."""
        if self.simulations < 1:
            raise InputError(f"simulations must be at least 1, not {self.simulations}")
        if not math.isfinite(self.alpha):
            raise InputError(f"alpha must be a finite number, not {self.alpha}")
