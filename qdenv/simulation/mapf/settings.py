"""The settings of a simulation of a fleet: how many drive, for how long, and who plans.

A planner is chosen by its name, an effort or its settings, and described in reports.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Annotated, Any, Literal

from annotated_types import Interval

from qdenv.devices import Backend
from qdenv.ranges import PositiveInt, Ranged
from qdenv.registry import Entry, Registry
from qdenv.simulation.mapf.negotiated.settings import EFFORTS, LOW, NegotiatedConfig
from qdenv.types import InputError, look_up

_MOST_TIMESTEPS = 10_000_000
MOST_STEPS = 2**31 - 1  # agent-steps, which are counted in 32 bits


@dataclass(frozen=True)
class PbsConfig(Ranged):
    """Priority-based search, window by window.

    Ma et al. 2019, https://arxiv.org/abs/1812.06356; windows of Li et al. 2021,
    https://arxiv.org/abs/2005.07371.
    """

    # what an agent does that finds no path past those with precedence over it. "published": it
    # stays even if others reserved its cell, and agents that wait at their start take precedence
    # there; so plans never fail, and crowds freeze. "plain": the search tries another order.
    rule: Literal["published", "plain"] = "published"
    # most nodes of the search tree that are expanded per window, in units of the number of agents;
    # a window that is still unsolved is driven by PIBT where its best plan has conflicts
    nodes_per_agent: Annotated[float, Interval(ge=0, le=1_000_000)] = 5.0


@dataclass(frozen=True)
class PibtConfig(Ranged):
    """Priority inheritance with backtracking, one timestep at a time.

    Okumura et al. 2022, https://arxiv.org/abs/1901.11282.
    """

    # where to run: compiled host code (also "auto") or XLA; the results are the same
    backend: Backend = "auto"
    # whether agents change places where two have no room to pass (Okumura 2023): for floors with
    # dead ends and narrow passages; always computed on the host
    swap: bool = False


# An entry's maker is called as make(settings) and returns a `Planner`.
PLANNERS = Registry(
    "planner",
    "qdenv.planners",
    {
        "negotiated": Entry(
            NegotiatedConfig, "qdenv.simulation.mapf.negotiated.planner:negotiated"
        ),
        "pbs": Entry(PbsConfig, "qdenv.simulation.mapf.pbs.planner:pbs"),
        "pibt": Entry(PibtConfig, "qdenv.simulation.mapf.pibt.planner:pibt"),
    },
)


@dataclass(frozen=True)
class FleetConfig(Ranged):
    """Settings of a simulation, all compile-time."""

    # number of robots, or the largest number if `simulate` takes fewer
    agents: PositiveInt = 200
    timesteps: PositiveInt = 1000  # length of a simulation, T in the paper
    # timesteps planned ahead, up to the planner's limit; the first `horizon` are without conflicts
    window: PositiveInt = 10
    horizon: PositiveInt = 5  # timesteps driven before planning again, the replanning period
    # settings record of the planner; its type says which one of `PLANNERS`
    planner: Any = field(default_factory=lambda: LOW)
    stop_when_congested: bool = True  # end the run at the first congested window
    # number of goal cells for which tables have room; None for one per cell of the layout
    goal_capacity: PositiveInt | None = None

    def __post_init__(self) -> None:
        """Refuse numbers that make no simulation, and what is no planner's settings."""
        super().__post_init__()
        if self.timesteps > _MOST_TIMESTEPS or self.agents * self.timesteps > MOST_STEPS:
            most = max(1, min(_MOST_TIMESTEPS, MOST_STEPS // self.agents))
            long = f"{self.agents} agents over {self.timesteps} timesteps are too many to count"
            raise InputError(f"{long}: simulate at most {most} timesteps")
        if self.horizon > self.window:
            raise InputError(f"horizon must be at most window, {self.window}, not {self.horizon}")
        PLANNERS.name_of(self.planner)


OWN = "negotiated"  # the planner where none is named, and the only one with efforts


def find_planner(effort: str | None = None, planner: Any = "", usual: str = "high") -> Any:
    """Choose a planner's settings by an effort, a planner's name, or the settings themselves.

    Efforts are those of the negotiated planner, `usual` where none is given. A name stands for the
    planner's defaults, "" for the negotiated one. Raises InputError if a name is unknown, settings
    are no planner's, or an effort is given with them or for another planner.
    """
    if isinstance(planner, str):
        if planner in ("", OWN):
            return look_up(EFFORTS, effort or usual, "effort")
        planner = PLANNERS.config(planner)
    name = PLANNERS.name_of(planner)
    if effort:
        reason = "its settings say all" if name == OWN else f"{name} has none"
        raise InputError(f"effort {effort} is for the {OWN} planner, and {reason}: leave it out")
    return planner


def check_costs(planner: Any) -> None:
    """Raise InputError if the planner of these settings knows no costs of moves."""
    if not PLANNERS.make(planner).reads_costs:
        name = PLANNERS.name_of(planner)
        cure = "choose negotiated, pibt or pbs, or --guidance none"
        raise InputError(f"the planner {name!r} knows no costs of moves: {cure}")


def describe_planner(settings: Any) -> str:
    """Name a planner and its settings for reports, like "pbs, rule plain, nodes per agent 10".

    The negotiated one by its effort, or the closest one, and where it differs from that.
    """
    name, values = PLANNERS.name_of(settings), asdict(settings)
    parts = [name]
    if name == OWN:
        others = {
            effort: {name: value for name, value in values.items() if value != asdict(known)[name]}
            for effort, known in EFFORTS.items()
        }
        effort = min(others, key=lambda effort: len(others[effort]))
        parts, values = [name, f"{effort} effort"], others[effort]
    for key, value in values.items():
        if key != "backend":  # it changes no result
            number = f"{value:g}" if isinstance(value, float) else value
            parts.append(f"{key.replace('_', ' ')} {number}")
    return ", ".join(parts)


def record_planner(settings: Any) -> dict[str, Any]:
    """List a planner's name and all its settings, for files."""
    return {"name": PLANNERS.name_of(settings), **asdict(settings)}
