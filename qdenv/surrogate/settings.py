"""The settings of the surrogate: what a user may choose."""

import math
from dataclasses import dataclass
from typing import Literal

from qdenv.types import InputError

UsageLoss = Literal["kl", "mse"]


@dataclass(frozen=True)
class SurrogateConfig:
    """The size of the surrogate and how it learns; the defaults suit a CPU.

    Attributes:
        channels: hidden channels of its networks; the last doubles them as its maps shrink.
        blocks: residual blocks of the networks that predict maps.
        epochs: how often each network sees all samples when it is fitted.
        minibatch: samples per step of learning.
        samples: the newest true evaluations that are kept to learn from.
        rate: learning rate of Adam.
        usage_loss: of the predicted tile usage: kl, of distributions, or mse, of numbers.
        standardise: learn objective and measures in units of their own spread; otherwise in their
            own units, as published, where the measure with the largest numbers decides.
        weights: of objective, result objective and each measure in the loss; 1 each unless given.
    """

    channels: int = 16
    blocks: int = 1
    epochs: int = 20
    minibatch: int = 64
    samples: int = 20_000
    rate: float = 1e-3
    usage_loss: UsageLoss = "kl"
    standardise: bool = True
    weights: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        """Refuse numbers that learn nothing."""
        for name in ("channels", "epochs", "minibatch", "samples"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} must be at least 1, not {getattr(self, name)}")
        if self.blocks < 0:
            raise InputError(f"blocks must be 0 or more, not {self.blocks}")
        if not 0 < self.rate < math.inf:
            raise InputError(f"rate must be a positive number, not {self.rate}")


# The published size, for GPUs; `python -m qdenv.bench surrogate` says what each takes.
PUBLISHED = SurrogateConfig(channels=64, blocks=2)
