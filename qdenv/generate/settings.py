"""The settings of the generators: what a user may choose."""

from dataclasses import dataclass

from qdenv.registry import Entry


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


NCA_GENERATOR = Entry(NcaConfig, "qdenv.generate.nca:nca")
