"""What a repair has found so far."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from qdenv.types import Repair, RepairStatus

Report = Callable[[str, float], None]  # told what is being done, and which share of it is done

TOLERANCE = 1e-6  # how far a bound may miss a cost that it proves


def no_report(doing: str, done: float) -> None:
    """Tell nobody how far a repair is."""


class Result(NamedTuple):
    """The best layout so far, and what is known of it."""

    layout: np.ndarray  # int8 [H, W]
    cost: float  # summed costs of its changed cells
    bound: float  # no layout costs less
    status: RepairStatus  # how the repair stands

    def proven(self, gap: float = 0.0) -> bool:
        """Whether the bound proves the cost within a relative gap."""
        return self.bound >= self.cost * (1 - gap) - TOLERANCE

    def record(self, seconds: float) -> Repair:
        """Fill a `Repair` with numpy values of the promised types."""
        numbers: list[Any] = [
            np.int32(self.status),
            np.float32(self.cost),
            np.float32(self.bound),
            np.float32(seconds),
        ]
        return Repair(self.layout.astype(np.int8), *numbers)
