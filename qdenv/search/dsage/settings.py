"""The settings of DSAGE: what a user may choose."""

from dataclasses import dataclass, field
from typing import ClassVar

from qdenv.ranges import NonNegativeInt, PositiveInt, Ranged
from qdenv.registry import Entry
from qdenv.surrogate.settings import PUBLISHED as PUBLISHED_SURROGATE
from qdenv.surrogate.settings import SurrogateConfig


@dataclass(frozen=True)
class DsageConfig(Ranged):
    """Settings of DSAGE; the defaults suit a CPU, `PUBLISHED` is the paper's.

    Attributes:
        batch: true evaluations per iteration.
        initial: random solutions that are evaluated first, rounded up to whole iterations.
        inner_iterations: of MAP-Elites on the surrogate, each time it has learnt.
        inner_batch: solutions of each of them.
        inner_random: the first of them draw random solutions.
        mutations: tiles that a mutation draws anew; 0 draws their number, 2 on average.
        downsample: blocks of the archive along each measure, from each of which one elite of the
            inner loop is evaluated truly; half, then a quarter of the cells unless given.
        surrogate: its size, and how it learns.
    """

    encoding: ClassVar[str] = "direct"  # the generator that it searches

    batch: PositiveInt = 50
    initial: PositiveInt = 100
    inner_iterations: PositiveInt = 500
    inner_batch: PositiveInt = 50
    inner_random: PositiveInt = 2
    mutations: NonNegativeInt = 0
    downsample: tuple[PositiveInt, ...] = ()
    surrogate: SurrogateConfig = field(default_factory=SurrogateConfig)


PUBLISHED = DsageConfig(inner_iterations=10_000, downsample=(50, 25), surrogate=PUBLISHED_SURROGATE)
DSAGE = Entry(DsageConfig, "qdenv.search.dsage.dsage:dsage")
