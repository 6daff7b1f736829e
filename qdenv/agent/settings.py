"""The settings of the agent's training: what a user may choose."""

import contextlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from annotated_types import Interval

from qdenv.io.files import refuse_second_run
from qdenv.io.records import read_json
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

_LARGEST_SIDE = 1000  # of a maze: nothing larger was tried


@dataclass(frozen=True)
class PPOConfig(Ranged):
    """Settings of PPO."""

    lanes: PositiveInt = 256  # environments that run side by side, E
    timesteps: PositiveInt = 128  # steps T of one rollout; gradients flow through all of them
    epochs: PositiveInt = 2  # passes over a rollout
    minibatches: PositiveInt = 4  # groups of environments per pass
    clip: PositiveFloat = 0.2  # epsilon, range of the probability ratio
    discount: Share = 0.995  # gamma
    trace: Share = 0.95  # lambda of generalized advantage estimation
    critic: NonNegativeFloat = 0.5  # weight of the value loss


@dataclass(frozen=True)
class RewardConfig(Ranged):
    """What is rewarded beside the goal."""

    novelty: FiniteFloat = 0.01  # reward of the first visit of a tile in an episode
    progress: FiniteFloat = 0.0  # reward of each move nearer to the goal (potential-based)
    haste: Share = 0.9  # share of the goal's reward that is lost by the horizon


@dataclass(frozen=True)
class LevelConfig(Ranged):
    """What levels look like."""

    size: Annotated[int, Interval(ge=2, le=_LARGEST_SIDE)] = 16  # rows and columns of the largest
    # rows and columns of the smallest; by default all levels have one size
    smallest: NonNegativeInt = 0
    # the largest has 0 to this many walls (or as many as its tiles), drawn at random; smaller ones
    # have fewer, in proportion to their area
    most_walls: NonNegativeInt = 110
    textured: Share = 0.25  # share of levels with a repeated pattern instead of independent walls
    longest: Share = 0.5  # share of levels with start and goal farthest apart
    # shortest and longest horizon of the largest; of others in proportion to their area
    horizon: tuple[PositiveInt, PositiveInt] = (250, 648)
    edits: NonNegativeInt = 5  # tiles flipped when a level is varied (ACCEL)

    def __post_init__(self) -> None:
        """Refuse sizes that make no mazes."""
        super().__post_init__()
        if self.smallest and not 2 <= self.smallest <= self.size:
            raise InputError(
                f"sizes {self.smallest} to {self.size} of mazes: give 2 or more, in order"
            )


@dataclass(frozen=True)
class TrainConfig(Ranged):
    """One training run."""

    method: Method = "dr"  # "dr" (domain randomisation), "plr" (robust PLR) or "accel"
    # environment steps to learn from, in all
    steps: Annotated[int, Interval(ge=1, lt=2**63)] = 80_000_000
    seed: Seed = 0  # random seed of everything
    units: PositiveInt = 64  # LSTM units of the agent
    # 4 (turn left, turn right, forward, stay), 3 (no stay) or 7 (the published set: 4 do nothing)
    actions: Annotated[int, Interval(ge=3, le=MOST)] = 4
    warm_start: str = ""  # an .npz agent to start from; "" for fresh weights
    # weight of the divergence from the policy of the warm start, so that the agent keeps what it
    # knows; 0 for none
    anchor: NonNegativeFloat = 0.0
    bank: PositiveInt = 4096  # levels C of the buffer under replay
    fresh: PositiveInt = 64  # new levels per update
    rate: PositiveFloat = 1e-3  # first learning rate; falls linearly to a twentieth
    entropy: NonNegativeFloat = 5e-3  # first weight of the entropy bonus; falls linearly to a tenth
    # share of the training after which the novelty reward has faded to nothing; it begins to fade
    # halfway there; 1 or more: it stays
    novelty_until: PositiveFloat = 1.0
    exam: PositiveInt = 32  # held-out mazes of each kind, played for every line of the log
    # number of agents, of the last lines of the log, whose mean weights make the final agent,
    # unless the last one alone does better in the exam
    average: PositiveInt = 8
    ppo: PPOConfig = field(default_factory=PPOConfig)  # numbers of the algorithm
    reward: RewardConfig = field(default_factory=RewardConfig)  # what is rewarded beside the goal
    levels: LevelConfig = field(default_factory=LevelConfig)  # what levels look like

    def __post_init__(self) -> None:
        """Refuse numbers that make no training."""
        super().__post_init__()
        if self.ppo.lanes % self.ppo.minibatches:
            raise InputError("minibatches must divide lanes")
        if self.anchor and not self.warm_start:
            raise InputError("an anchor is a policy to start from: add --warm-start AGENT.npz")
        if self.fresh > self.bank:
            raise InputError("fresh must be at most bank, the levels in the buffer")

    @property
    def updates(self) -> int:
        """Number of updates of the whole run."""
        return -(-self.steps // (self.ppo.lanes * self.ppo.timesteps))


def refuse_second_training(folder: Path) -> None:
    """Raise InputError if the training of an agent would replace anything in a folder."""
    begun: tuple[str, ...] = ()
    with contextlib.suppress(InputError):
        read_json(folder / "config.json", TrainConfig)  # of one that was killed before it saved
        begun = ("config.json",)
    refuse_second_run(folder, begun)
