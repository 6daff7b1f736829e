"""The settings of a simulation of a fleet: how many drive, for how long, and who plans."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from qdenv.ranges import PositiveInt, Ranged
from qdenv.registry import Registry
from qdenv.simulate.mapf.negotiated.settings import LOW
from qdenv.types import InputError

if TYPE_CHECKING:  # the planners themselves import both compilers
    from qdenv.simulate.mapf.planner import Planner

MOST_TIMESTEPS = 10_000_000
MOST_STEPS = 2**31 - 1  # agent-steps, which are counted in 32 bits

# An entry's maker is called as make(settings) and returns a `Planner`.
PLANNERS = Registry(
    "planner",
    "qdenv.planners",
    {
        "negotiated": "qdenv.simulate.mapf.negotiated.settings:NEGOTIATED",
        "pbs": "qdenv.simulate.mapf.pbs.settings:PBS",
        "pibt": "qdenv.simulate.mapf.pibt.settings:PIBT",
    },
)


@dataclass(frozen=True)
class FleetConfig(Ranged):
    """The numbers of a simulation, all compile-time."""

    # how many robots drive, or the most of them when `simulate` is told fewer
    agents: PositiveInt = 200
    timesteps: PositiveInt = 1000  # how long a simulation lasts, T
    # timesteps planned ahead without conflict (w), at most what the planner can do
    window: PositiveInt = 10
    horizon: PositiveInt = 5  # timesteps driven before planning again, the replanning period (h)
    # settings record of the planner; its type says which one of `PLANNERS`
    planner: Any = field(default_factory=lambda: LOW)
    stop_when_congested: bool = True  # end the run at the first congested window
    # goal cells the tables have room for; None for one per cell of the layout
    goal_capacity: PositiveInt | None = None

    def __post_init__(self) -> None:
        """Refuse numbers that make no simulation, and what is no planner's settings."""
        super().__post_init__()
        if self.timesteps > MOST_TIMESTEPS or self.agents * self.timesteps > MOST_STEPS:
            most = max(1, min(MOST_TIMESTEPS, MOST_STEPS // self.agents))
            raise InputError(
                f"{self.agents} agents over {self.timesteps} timesteps are more than a run can "
                f"count: simulate at most {most} timesteps"
            )
        if self.horizon > self.window:
            raise InputError(f"a horizon of {self.horizon} is beyond the window, {self.window}")
        PLANNERS.name_of(self.planner)

    def make_planner(self) -> Planner:
        """Make the planner that the settings choose.

        Raises:
            InputError: no planner is registered for their type.
        """
        return PLANNERS.make(self.planner)
