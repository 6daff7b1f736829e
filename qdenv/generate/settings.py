"""The settings of the generators: what a user may choose."""

from dataclasses import dataclass

from qdenv.registry import Entry
from qdenv.types import InputError


@dataclass(frozen=True)
class NcaConfig:
    """The numbers of a neural cellular automaton.

    Attributes:
        steps: NCA steps C.
        kernel_sizes: kernel widths of the convolutions.
        hidden: channels of the hidden layers.
    """

    steps: int = 50
    kernel_sizes: tuple[int, ...] = (3, 3, 3)
    hidden: int = 32

    def __post_init__(self) -> None:
        """Refuse numbers that make no automaton."""
        if self.steps < 0 or self.hidden < 1:
            raise InputError(
                f"an automaton takes 0 steps or more and has at least 1 hidden channel, not "
                f"{self.steps} and {self.hidden}"
            )


NCA_GENERATOR = Entry(NcaConfig, "qdenv.generate.nca:nca")
