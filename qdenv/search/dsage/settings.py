"""The settings of DSAGE: what a user may choose."""

from dataclasses import dataclass, field
from typing import ClassVar

from qdenv.registry import Entry
from qdenv.surrogate.settings import PUBLISHED as PUBLISHED_SURROGATE
from qdenv.surrogate.settings import SurrogateConfig
from qdenv.types import InputError


@dataclass(frozen=True)
class DsageConfig:
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

    batch: int = 50
    initial: int = 100
    inner_iterations: int = 500
    inner_batch: int = 50
    inner_random: int = 2
    mutations: int = 0
    downsample: tuple[int, ...] = ()
    surrogate: SurrogateConfig = field(default_factory=SurrogateConfig)

    def __post_init__(self) -> None:
        """Refuse numbers that make no search."""
        for name in ("batch", "initial", "inner_iterations", "inner_batch", "inner_random"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} must be at least 1, not {getattr(self, name)}")
        if self.mutations < 0 or any(blocks < 1 for blocks in self.downsample):
            raise InputError("mutations must be 0 or more, blocks of downsample 1 or more")


PUBLISHED = DsageConfig(inner_iterations=10_000, downsample=(50, 25), surrogate=PUBLISHED_SURROGATE)
DSAGE = Entry(DsageConfig, "qdenv.search.dsage.dsage:dsage")
