"""The settings of the agent's training: what a user may choose."""

from dataclasses import dataclass, field
from typing import Literal, get_args

from qdenv.types import InputError

Method = Literal["dr", "plr", "accel"]


@dataclass(frozen=True)
class PPOConfig:
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

    lanes: int = 256
    timesteps: int = 128
    epochs: int = 2
    minibatches: int = 4
    clip: float = 0.2
    discount: float = 0.995
    trace: float = 0.95
    critic: float = 0.5


@dataclass(frozen=True)
class RewardConfig:
    """What is rewarded beside the goal.

    Attributes:
        novelty: the first visit of a tile in an episode.
        progress: each move nearer to the goal (potential-based).
        haste: share of the goal's reward that is lost by the horizon.
    """

    novelty: float = 0.01
    progress: float = 0.0
    haste: float = 0.9


@dataclass(frozen=True)
class LevelConfig:
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

    size: int = 16
    smallest: int = 0
    most_walls: int = 110
    textured: float = 0.25
    longest: float = 0.5
    horizon: tuple[int, int] = (250, 648)
    edits: int = 5

    def __post_init__(self) -> None:
        """Refuse sizes that make no mazes."""
        if self.size < 2 or (self.smallest and not 2 <= self.smallest <= self.size):
            raise InputError(
                f"sizes of mazes, {self.smallest} to {self.size}: give 2 or more, in order"
            )


@dataclass(frozen=True)
class TrainConfig:
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
        ppo: numbers of the algorithm.
        reward: what is rewarded beside the goal.
        levels: what levels look like.
    """

    method: Method = "dr"
    steps: int = 80_000_000
    seed: int = 0
    units: int = 64
    actions: int = 3
    warm_start: str = ""
    anchor: float = 0.0
    bank: int = 4096
    fresh: int = 64
    rate: float = 1e-3
    entropy: float = 5e-3
    novelty_until: float = 1.0
    exam: int = 32
    ppo: PPOConfig = field(default_factory=PPOConfig)
    reward: RewardConfig = field(default_factory=RewardConfig)
    levels: LevelConfig = field(default_factory=LevelConfig)

    def __post_init__(self) -> None:
        """Refuse numbers that make no training."""
        if self.method not in get_args(Method):
            raise InputError(f"unknown method {self.method!r}: choose one of dr, plr, accel")
        if self.actions < 3 or self.units < 1 or self.steps < 1:
            raise InputError("the agent needs at least 3 actions, 1 unit and 1 step")
        sizes = (self.ppo.lanes, self.ppo.timesteps, self.ppo.epochs, self.ppo.minibatches)
        if min(sizes) < 1 or self.ppo.lanes % self.ppo.minibatches:
            raise InputError("minibatches must divide lanes, and all numbers of PPO be 1 or more")
        if self.anchor and not self.warm_start:
            raise InputError("an anchor is a policy to start from: add --warm-start AGENT.npz")
        if not 0 < self.fresh <= self.bank:
            raise InputError("fresh levels per update must number between 1 and the bank's size")
        if not 0 <= self.seed < 2**32:
            raise InputError(f"seed {self.seed}: give 0 to {2**32 - 1}")

    @property
    def updates(self) -> int:
        """Count the updates of the whole run."""
        return -(-self.steps // (self.ppo.lanes * self.ppo.timesteps))
