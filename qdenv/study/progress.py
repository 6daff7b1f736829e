"""How studies tell how far they are."""

from collections.abc import Callable
from typing import TypeAlias

COMPILING = "compiling the simulator"
SIMULATING = "simulating"

# (what is done, which share of it; below 0 where nobody knows, a word on how things stand)
Progress: TypeAlias = Callable[[str, float, str], None]


def silent(doing: str, share: float, note: str) -> None:
    """Tell nobody of any progress."""
