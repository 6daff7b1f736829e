"""The settings of the generators: what a user may choose."""

from collections.abc import Sequence
from dataclasses import dataclass

from qdenv.ranges import PositiveInt, Ranged
from qdenv.registry import Entry
from qdenv.types import InputError


def check_kernels(sizes: Sequence[int]) -> None:
    """Refuse kernels that are even or not positive: without a centre cell the drawing would drift.

    Raises:
        InputError: one is, or there is none.
    """
    if not sizes or any(size < 1 or size % 2 == 0 for size in sizes):
        raise InputError(f"kernel sizes {tuple(sizes)} must be positive odd numbers")


@dataclass(frozen=True)
class NcaConfig(Ranged):
    """The numbers of a neural cellular automaton."""

    steps: PositiveInt = 50  # how often the drawing grows, the NCA steps C
    kernel_sizes: tuple[int, ...] = (3, 3, 3)  # widths of the kernels of its convolutions, in cells
    hidden: PositiveInt = 32  # channels of its hidden layers

    def __post_init__(self) -> None:
        """Refuse what draws nothing."""
        super().__post_init__()
        check_kernels(self.kernel_sizes)


@dataclass(frozen=True)
class DirectConfig:
    """The numbers of the generator that draws nothing: a solution is the tiles themselves."""


DIRECT_GENERATOR = Entry(DirectConfig, "qdenv.generate.direct:direct")
NCA_GENERATOR = Entry(NcaConfig, "qdenv.generate.nca:nca")
