"""What an attack of the campaign is: a name, what it counts, and one attempt from a seed."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np


@dataclass(frozen=True)
class Attempt:
    """What one attempt did.

    Attributes:
        count: how much was tried, in the attack's unit.
        faults: a line for each promise that was broken; empty when all held.
        notes: other counts by name, added up over attempts.
    """

    count: int
    faults: tuple[str, ...] = ()
    notes: Mapping[str, int] = field(default_factory=dict)


class Attack(NamedTuple):
    """One kind of attempt to break a promise.

    Attributes:
        name: as `--only` takes it.
        promise: what must hold, in a few words.
        unit: what is counted, in plural.
        attempt: (chance, an empty folder to work in) -> what happened. Everything that varies is
            drawn from `chance`, so the seed of an attempt repeats it.
    """

    name: str
    promise: str
    unit: str
    attempt: Callable[[np.random.Generator, Path], Attempt]
