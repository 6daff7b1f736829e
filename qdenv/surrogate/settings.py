"""The settings of the surrogate: what a user may choose."""

from dataclasses import dataclass
from typing import Literal

from qdenv.ranges import NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt, Ranged

UsageLoss = Literal["kl", "mse"]


@dataclass(frozen=True)
class SurrogateConfig(Ranged):
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

    channels: PositiveInt = 16
    blocks: NonNegativeInt = 1
    epochs: PositiveInt = 20
    minibatch: PositiveInt = 64
    samples: PositiveInt = 20_000
    rate: PositiveFloat = 1e-3
    usage_loss: UsageLoss = "kl"
    standardise: bool = True
    weights: tuple[NonNegativeFloat, ...] = ()


# The published size, for GPUs; `python -m experiments.benchmarks surrogate` says what each takes.
PUBLISHED = SurrogateConfig(channels=64, blocks=2)
