"""What an attack of the campaign is: a name, what it counts, and one attempt from a seed."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np


@dataclass(frozen=True)
class Attempt:
    """What one attempt did."""

    count: int  # how much was tried, in the attack's unit
    faults: tuple[str, ...] = ()  # a line for each promise that was broken; empty when all held
    # other counts by name, added up over attempts
    notes: Mapping[str, int] = field(default_factory=dict)


class Attack(NamedTuple):
    """One kind of attempt to break a promise."""

    name: str  # as `--only` takes it
    promise: str  # what must hold, in a few words
    unit: str  # what is counted, in plural
    # (chance, an empty folder to work in) -> what happened. Everything that varies is drawn from
    # `chance`, so the seed of an attempt repeats it.
    attempt: Callable[[np.random.Generator, Path], Attempt]
