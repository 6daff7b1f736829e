"""The settings of DSAGE: what a user may choose."""

from dataclasses import dataclass, field
from typing import ClassVar

from qdenv.ranges import NonNegativeInt, PositiveInt, Ranged
from qdenv.registry import Entry
from qdenv.surrogate.settings import PUBLISHED as PUBLISHED_SURROGATE
from qdenv.surrogate.settings import SurrogateConfig


@dataclass(frozen=True)
class DsageConfig(Ranged):
    """Settings of DSAGE; the defaults suit a CPU, `PUBLISHED` is the paper's."""

    encoding: ClassVar[str] = "direct"  # the generator that it searches

    batch: PositiveInt = 50  # true evaluations per iteration
    # random solutions that are evaluated first, rounded up to whole iterations
    initial: PositiveInt = 100
    inner_iterations: PositiveInt = 500  # of MAP-Elites on the surrogate, each time it has learnt
    inner_batch: PositiveInt = 50  # solutions of each of them
    inner_random: PositiveInt = 2  # the first of them draw random solutions
    # tiles that a mutation draws anew; 0 draws their number, 2 on average
    mutations: NonNegativeInt = 0
    # blocks of the archive along each measure, from each of which one elite of the inner loop is
    # evaluated truly; half, then a quarter of the cells unless given
    downsample: tuple[PositiveInt, ...] = ()
    # its size, and how it learns
    surrogate: SurrogateConfig = field(default_factory=SurrogateConfig)


PUBLISHED = DsageConfig(inner_iterations=10_000, downsample=(50, 25), surrogate=PUBLISHED_SURROGATE)
DSAGE = Entry(DsageConfig, "qdenv.search.dsage.dsage:dsage")
