"""The repair of one layout: annealed start, HiGHS polish, lazy cuts, limits and status."""

from dataclasses import dataclass


@dataclass(frozen=True)
class RepairConfig:
    """Limits of one repair."""

    polish: str = "quick"
