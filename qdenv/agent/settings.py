"""The settings of the agent's training: what a user may choose."""

from dataclasses import dataclass, field
from typing import Annotated, Literal, get_args

from annotated_types import Interval

from qdenv.ranges import (
    MOST,
    FiniteFloat,
    NonNegativeFloat,
    NonNegativeInt,
    PositiveFloat,
    PositiveInt,
    Ranged,
    Seed,
    Share,
)
from qdenv.types import InputError

Method = Literal["dr", "plr", "accel"]

LARGEST_SIDE = 1000  # of a maze: nothing larger was tried


@dataclass(frozen=True)
class PPOConfig(Ranged):
    """Numbers of the algorithm.

    Attributes:
        lanes: environments that run side by side, E.
        timesteps: steps T of one rollout; gradients flow through all of them.
        epochs: passes over a rollout.
        minibatches: groups of environments per pass.
        clip: epsilon, range of the probability ratio.
        discount: gamma.
        trace: lambda of generalized advantage estimation.
        critic: weight of the value loss.
    """

    lanes: PositiveInt = 256
    timesteps: PositiveInt = 128
    epochs: PositiveInt = 2
    minibatches: PositiveInt = 4
    clip: PositiveFloat = 0.2
    discount: Share = 0.995
    trace: Share = 0.95
    critic: NonNegativeFloat = 0.5


@dataclass(frozen=True)
class RewardConfig(Ranged):
    """What is rewarded beside the goal.

    Attributes:
        novelty: the first visit of a tile in an episode.
        progress: each move nearer to the goal (potential-based).
        haste: share of the goal's reward that is lost by the horizon.
    """

    novelty: FiniteFloat = 0.01
    progress: FiniteFloat = 0.0
    haste: Share = 0.9


@dataclass(frozen=True)
class LevelConfig(Ranged):
    """What levels look like.

    Attributes:
        size: rows and columns of the largest.
        smallest: rows and columns of the smallest; all are of one size unless given.
        most_walls: walls of the largest are drawn from 0 to this; smaller ones have fewer in
            proportion to their area.
        textured: share of levels with a repeated pattern instead of independent walls.
        longest: share of levels with the longest-path pair.
        horizon: shortest and longest horizon of the largest; in proportion to the area.
        edits: tiles flipped when a level is varied (ACCEL).
    """

    size: Annotated[int, Interval(ge=2, le=LARGEST_SIDE)] = 16
    smallest: NonNegativeInt = 0
    most_walls: NonNegativeInt = 110
    textured: Share = 0.25
    longest: Share = 0.5
    horizon: tuple[PositiveInt, PositiveInt] = (250, 648)
    edits: NonNegativeInt = 5

    def __post_init__(self) -> None:
        """Refuse sizes that make no mazes."""
        super().__post_init__()
        if self.smallest and not 2 <= self.smallest <= self.size:
            raise InputError(
                f"sizes of mazes, {self.smallest} to {self.size}: give 2 or more, in order"
            )


@dataclass(frozen=True)
class TrainConfig(Ranged):
    """One training run.

    Attributes:
        method: "dr" (domain randomisation), "plr" (robust PLR) or "accel".
        steps: environment steps to learn from, in all.
        seed: of everything.
        units: LSTM units of the agent.
        actions: 3 (turn left, turn right, forward) or 7 (the published set, 4 do nothing).
        warm_start: an .npz agent to start from; "" for fresh weights.
        anchor: weight of the divergence from the policy of the warm start, which keeps what it
            knows; 0 lets it go.
        bank: levels C of the buffer under replay.
        fresh: new levels per update.
        rate: first learning rate; falls linearly to a twentieth.
        entropy: first weight of the entropy bonus; falls linearly to a tenth.
        novelty_until: share of the training after which the novelty reward has faded to nothing;
            it begins to fade halfway there.
        exam: held-out mazes of each kind, played for every line of the log.
        average: agents, those of the last lines of the log, whose mean weights are the agent that
            is kept, unless the last alone does better in the exam.
        ppo: numbers of the algorithm.
        reward: what is rewarded beside the goal.
        levels: what levels look like.
    """

    method: Method = "dr"
    steps: Annotated[int, Interval(ge=1, lt=2**63)] = 80_000_000
    seed: Seed = 0
    units: PositiveInt = 64
    actions: Annotated[int, Interval(ge=3, le=MOST)] = 3
    warm_start: str = ""
    anchor: NonNegativeFloat = 0.0
    bank: PositiveInt = 4096
    fresh: PositiveInt = 64
    rate: PositiveFloat = 1e-3
    entropy: NonNegativeFloat = 5e-3
    novelty_until: PositiveFloat = 1.0
    exam: PositiveInt = 32
    average: PositiveInt = 8
    ppo: PPOConfig = field(default_factory=PPOConfig)
    reward: RewardConfig = field(default_factory=RewardConfig)
    levels: LevelConfig = field(default_factory=LevelConfig)

    def __post_init__(self) -> None:
        """Refuse numbers that make no training."""
        super().__post_init__()
        if self.method not in get_args(Method):
            raise InputError(f"unknown method {self.method!r}: choose one of dr, plr, accel")
        if self.ppo.lanes % self.ppo.minibatches:
            raise InputError("minibatches must divide lanes")
        if self.anchor and not self.warm_start:
            raise InputError("an anchor is a policy to start from: add --warm-start AGENT.npz")
        if self.fresh > self.bank:
            raise InputError("more levels are fresh in an update than the bank holds")

    @property
    def updates(self) -> int:
        """Count the updates of the whole run."""
        return -(-self.steps // (self.ppo.lanes * self.ppo.timesteps))
