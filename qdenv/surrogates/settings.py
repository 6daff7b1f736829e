"""The settings of the surrogate: what a user may choose."""

from dataclasses import dataclass
from typing import Literal

from qdenv.ranges import NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt, Ranged


@dataclass(frozen=True)
class SurrogateConfig(Ranged):
    """The size of the surrogate and how it learns; the defaults suit a CPU."""

    # hidden channels of its networks; the last doubles them as its maps shrink
    channels: PositiveInt = 16
    blocks: NonNegativeInt = 1  # residual blocks of the networks that predict maps
    epochs: PositiveInt = 20  # how often each network sees all samples when it is fitted
    minibatch: PositiveInt = 64  # samples per step of learning
    samples: PositiveInt = 20_000  # the newest true evaluations, to learn from
    rate: PositiveFloat = 1e-3  # learning rate of Adam
    # of the predicted tile usage: kl, of distributions, or mse, of numbers
    usage_loss: Literal["kl", "mse"] = "kl"
    # learn objective and measures in units of their own spread; otherwise in their own units, as
    # published, where the measure with the largest numbers decides
    standardise: bool = True
    # of objective, result objective and each measure in the loss; 1 each unless given
    weights: tuple[NonNegativeFloat, ...] = ()


# The published size, for GPUs; `python -m experiments.benchmarks surrogate` times each.
PUBLISHED = SurrogateConfig(channels=64, blocks=2)
